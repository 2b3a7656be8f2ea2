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

std::vector<Point> points() {
    std::vector<Point> ground(numbers<int>(1)[0]);
    for (Point& p : ground) std::cin >> p.x >> p.z;
    return ground;
}

int main() {
    int instants, highest, rows, outputs, joints, sides;
    double window, limit;
    Layout layout{};
    std::cin >> instants >> layout.bins >> layout.bin_width >> highest >> layout.frames;
    std::cin >> window >> limit >> rows >> outputs >> joints >> sides;
    layout.highest = highest != 0;
    layout.sides = sides != 0;
    std::vector<Joints> actions(rows);
    for (Joints& row : actions) row = numbers<double>(joints);

    History history(layout.frames);
    double input_error = 0, target_error = 0;
    for (int i = 0; i < instants; ++i) {
        if (numbers<int>(1)[0]) history.clear();
        const auto below = points();
        const auto left = points(), right = points();
        const auto measured = numbers<double>(joints), tilt = numbers<double>(2);
        const Beside beside{left, right, tilt[1]};
        const auto input = history.push(observation(layout, below, measured, tilt[0], beside));
        const auto wanted = numbers<double>(input.size());
        for (std::size_t k = 0; k < input.size(); ++k) {
            input_error = std::max(input_error, std::abs(wanted[k] - input[k]));
        }
        const auto answers = numbers<float>(outputs);
        const auto last = numbers<double>(joints), expected = numbers<double>(joints);
        const Joints next = next_targets(last, measured, turn(answers, actions), window, limit);
        for (int k = 0; k < joints; ++k) {
            target_error = std::max(target_error, std::abs(expected[k] - next[k]));
        }
    }
    std::printf("%d instants: inputs differ by %.2g, targets by %.2g rad\n", instants, input_error, target_error);
    return input_error < 1e-6 && target_error < 1e-9 ? 0 : 1;
}
