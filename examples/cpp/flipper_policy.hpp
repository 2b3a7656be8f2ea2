// What a robot computes around the network of an exported policy, in C++17 without any library.
//
// From points of the ground and the measured angles to the input of the network, and from its
// outputs to the angles to turn the flippers to. Run the network itself by onnxruntime's C++ API:
// one input "observation", float32 (1, frames * n); one output "q_values" or "rates". For pairs, J = 2
// joints, these are (1, 9) and (1, 2); for four flippers (1, 81) and (1, 4).
// All is in SI units; frames and signs are those of docs/robot.md. "flipperctl export vectors"
// writes what each function must return.
#pragma once

#include <algorithm>
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
    bool sides;        // whether the heights of both sides and the roll follow
};

struct Beside {
    std::vector<Point> left, right;  // below the tracks of each side; empty: as in the middle
    double roll = 0;                 // left side up positive [rad]
};

using Joints = std::vector<double>;  // of all J joints, the front ones first, left before right [rad]

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

inline void add_heights(
    std::vector<float>& row, const Layout& layout, const std::vector<Point>& points) {
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
    row.insert(row.end(), sum.begin(), sum.end());
    if (layout.highest) row.insert(row.end(), top.begin(), top.end());
}
}  // namespace detail

// The observation: mean height of each bin from rear to front, then the highest ones if the layout
// has them; with sides, those of the left, of the right and the roll; the angles and the pitch.
//
// A bin begins at its rear edge and ends before its front edge, but a point on the front end of all
// belongs to the last. Points farther than half the perceived length are ignored.
inline std::vector<float> observation(
    const Layout& layout, const std::vector<Point>& points, const Joints& angles, double pitch,
    const Beside& beside = {}) {
    std::vector<float> row;
    detail::add_heights(row, layout, points);
    if (layout.sides) {
        for (const auto* side : {&beside.left, &beside.right}) {
            detail::add_heights(row, layout, side->empty() ? points : *side);
        }
        row.push_back(static_cast<float>(beside.roll));
    }
    for (double angle : angles) row.push_back(static_cast<float>(angle));
    row.push_back(static_cast<float>(pitch));
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

// The turn of all joints: that of the largest Q-value, the first of equal ones, or by rates, which
// are rounded to steps of 0.001. "actions" are the rows of the file, (3^J, J) or (J, J).
inline Joints turn(const std::vector<float>& outputs, const std::vector<Joints>& actions) {
    const std::size_t joints = actions[0].size();
    if (outputs.size() > joints) {
        return actions[std::max_element(outputs.begin(), outputs.end()) - outputs.begin()];
    }
    Joints turns(joints, 0.0);
    for (std::size_t i = 0; i < joints; ++i) {
        const double rate = std::clamp(static_cast<double>(outputs[i]), -1.0, 1.0);
        for (std::size_t k = 0; k < joints; ++k) {
            turns[k] += std::nearbyint(rate * 1000.0) / 1000.0 * actions[i][k];
        }
    }
    return turns;
}

// The new targets. Before the first decision of an episode the last ones are the measured angles.
inline Joints next_targets(
    const Joints& last, const Joints& measured, const Joints& turn, double window, double limit) {
    Joints next(last.size());
    for (std::size_t i = 0; i < next.size(); ++i) {
        const double near = std::clamp(last[i], measured[i] - window, measured[i] + window);
        next[i] = std::clamp(near + turn[i], -limit, limit);
    }
    return next;
}

}  // namespace flipperctl
