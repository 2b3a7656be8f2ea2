// Compares flipper_policy.hpp with recorded instants: c++ -std=c++17 -O1 check.cpp -o check.
//
// Reads numbers from its input, as examples/cpp/check.py writes them from "flipperctl export
// vectors"; prints the largest differences and ends with 1 if one is too large.
#include <cstdio>
#include <iostream>

#include "flipper_policy.hpp"

using namespace flipperctl;

template <typename T>
std::vector<T> numbers(std::size_t count) {
    std::vector<T> values(count);
    for (T& value : values) {
        if (!(std::cin >> value)) throw std::runtime_error("the input ends too early");
    }
    return values;
}

int main() {
    int instants, highest, rows, outputs;
    double window, limit;
    Layout layout{};
    std::cin >> instants >> layout.bins >> layout.bin_width >> highest >> layout.frames;
    std::cin >> window >> limit >> rows >> outputs;
    layout.highest = highest != 0;
    std::vector<Pair> actions(rows);
    for (Pair& row : actions) std::cin >> row[0] >> row[1];

    History history(layout.frames);
    double input_error = 0, target_error = 0;
    for (int i = 0; i < instants; ++i) {
        const int begins = numbers<int>(1)[0], count = numbers<int>(1)[0];
        std::vector<Point> points(count);
        for (Point& p : points) std::cin >> p.x >> p.z;
        const auto angles = numbers<double>(3);
        if (begins) history.clear();
        const Pair measured{angles[0], angles[1]};
        const auto input = history.push(observation(layout, points, measured, angles[2]));
        const auto wanted = numbers<double>(input.size());
        for (std::size_t k = 0; k < input.size(); ++k) {
            input_error = std::max(input_error, std::abs(wanted[k] - input[k]));
        }
        const auto answers = numbers<float>(outputs);
        const auto last = numbers<double>(2), expected = numbers<double>(2);
        const Pair next = next_targets({last[0], last[1]}, measured, turn(answers, actions), window, limit);
        for (int k = 0; k < 2; ++k) {
            target_error = std::max(target_error, std::abs(expected[k] - next[k]));
        }
    }
    std::printf("%d instants: inputs differ by %.2g, targets by %.2g rad\n", instants, input_error, target_error);
    return input_error < 1e-6 && target_error < 1e-9 ? 0 : 1;
}
