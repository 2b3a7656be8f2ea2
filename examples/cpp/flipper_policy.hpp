// What a robot computes around the network of an exported policy, in C++17 without any library.
//
// From points of the ground and the measured angles to the input of the network, and from its
// outputs to the angles to turn the flippers to. Run the network itself by onnxruntime's C++ API:
// one input "observation", float32 (1, frames * n); one output "q_values" (1, 9) or "rates" (1, 2).
// All is in SI units; frames and signs are those of docs/robot.md. "flipperctl export vectors"
// writes what each function must return.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <deque>
#include <limits>
#include <stdexcept>
#include <vector>

namespace flipperctl {

struct Point {
    double x, z;  // ahead of and above the chassis centre, level [m]
};

struct Layout {
    int bins;
    double bin_width;  // [m]
    bool highest;      // whether the heights of the highest points follow the means
    int frames;        // observations in one input, oldest first
};

using Pair = std::array<double, 2>;  // of the front and the rear flippers [rad]

// Points in the frame of the chassis, which is pitched nose up, in the level frame.
inline std::vector<Point> to_level(std::vector<Point> points, double pitch) {
    const double c = std::cos(pitch), s = std::sin(pitch);
    for (Point& p : points) p = {c * p.x - s * p.z, s * p.x + c * p.z};
    return points;
}

namespace detail {
// Values of bins without points: on a line between their neighbours, level beyond the outermost.
inline void fill(std::vector<double>& values, const std::vector<int>& counts) {
    const int n = static_cast<int>(values.size());
    int before = -1;
    for (int i = 0; i <= n; ++i) {
        if (i < n && counts[i] == 0) continue;
        for (int k = before + 1; k < i; ++k) {
            if (before < 0) {
                values[k] = values[i];
            } else if (i == n) {
                values[k] = values[before];
            } else {
                const double slope = (values[i] - values[before]) / (i - before);
                values[k] = slope * (k - before) + values[before];
            }
        }
        before = i;
    }
}
}  // namespace detail

// The observation: mean height of each bin from rear to front, then the highest ones if the layout
// has them, then the angles of both pairs and the pitch.
//
// A bin begins at its rear edge and ends before its front edge, but a point on the front end of all
// belongs to the last. Points farther than half the perceived length are ignored.
inline std::vector<float> observation(
    const Layout& layout, const std::vector<Point>& points, Pair angles, double pitch) {
    const double reach = layout.bins * layout.bin_width / 2;
    std::vector<double> sum(layout.bins, 0.0);
    std::vector<double> top(layout.bins, -std::numeric_limits<double>::infinity());
    std::vector<int> counts(layout.bins, 0);
    int seen = 0;
    for (const Point& p : points) {
        if (!std::isfinite(p.x) || !std::isfinite(p.z)) throw std::invalid_argument("not finite");
        if (std::abs(p.x) > reach + 1e-9) continue;
        const int bin = std::min(static_cast<int>((p.x + reach) / layout.bin_width), layout.bins - 1);
        seen += counts[bin] == 0;
        sum[bin] += p.z;
        counts[bin] += 1;
        top[bin] = std::max(top[bin], p.z);
    }
    // Without any ground nothing can be decided: zeros would be level ground.
    if (seen == 0) throw std::invalid_argument("no point lies within the bins");
    for (int i = 0; i < layout.bins; ++i) {
        if (counts[i] > 0) sum[i] /= counts[i];
    }
    detail::fill(sum, counts);
    detail::fill(top, counts);
    std::vector<float> row(sum.begin(), sum.end());
    if (layout.highest) row.insert(row.end(), top.begin(), top.end());
    for (double angle : {angles[0], angles[1], pitch}) row.push_back(static_cast<float>(angle));
    return row;
}

// The input of the network. At the start of an episode, after clear(), the first observation also
// fills the frames before it.
class History {
  public:
    explicit History(int frames) : frames_(frames) {}
    void clear() { rows_.clear(); }
    std::vector<float> push(const std::vector<float>& row) {
        if (rows_.empty()) rows_.assign(frames_, row);
        rows_.pop_front();
        rows_.push_back(row);
        std::vector<float> input;
        for (const auto& each : rows_) input.insert(input.end(), each.begin(), each.end());
        return input;
    }

  private:
    int frames_;
    std::deque<std::vector<float>> rows_;
};

// The turn of both pairs: that of the largest Q-value, the first of equal ones, or by rates, which
// are rounded to steps of 0.001. "actions" are the rows of the file, (9, 2) or (2, 2).
inline Pair turn(const std::vector<float>& outputs, const std::vector<Pair>& actions) {
    if (outputs.size() > 2) {
        return actions[std::max_element(outputs.begin(), outputs.end()) - outputs.begin()];
    }
    Pair rates;
    for (int i = 0; i < 2; ++i) {
        const double rate = std::clamp(static_cast<double>(outputs[i]), -1.0, 1.0);
        rates[i] = std::nearbyint(rate * 1000.0) / 1000.0;
    }
    return {rates[0] * actions[0][0] + rates[1] * actions[1][0],
            rates[0] * actions[0][1] + rates[1] * actions[1][1]};
}

// The new targets. Before the first decision of an episode the last ones are the measured angles.
inline Pair next_targets(Pair last, Pair measured, Pair turn, double window, double limit) {
    Pair next;
    for (int i = 0; i < 2; ++i) {
        const double near = std::clamp(last[i], measured[i] - window, measured[i] + window);
        next[i] = std::clamp(near + turn[i], -limit, limit);
    }
    return next;
}

}  // namespace flipperctl
