// Inputs that hunt trouble: for each kind of argument of the shared functions a distribution that seeks its edges, and
// the tables (maps of a fabric, lights) that functions read: row_tables(), made on first use, the same in every run.
// All of it follows from (function, index) by a counter-based hash.
#pragma once
#include <cstdint>
#include <string_view>
#include <vector>

#include "tests/cpp/row_readers.hpp"

namespace stability
{

// How a group of outputs is judged.
struct Output {
    int width;    // numbers that form one vector: the error is measured against its length
    double floor; // lengths below count as this
    double low;   // numbers must lie in [low, high]
    double high;
    bool unit; // a vector of length 1, or 0 where the function gives nothing
    std::string_view kind;
};

struct Kind; // of arguments: its width and its distribution

// The kinds of a function's arguments and results.
struct Signature {
    std::uint64_t stream; // of random numbers, by the function's name
    std::vector<const Kind*> inputs;
    std::vector<Output> outputs;
};

// Throws std::runtime_error where nobody has said what the function takes, or where that is not `inputs` and `outputs`
// numbers long: a function without a distribution is an error, never skipped.
Signature signature_of(std::string_view function, int inputs, int outputs);

// Draws input `index` of a function: signature.inputs' numbers, each a float. Pure.
void draw_inputs(const Signature& signature, std::uint64_t index, double* numbers);

// The same input with each measurement moved by up to 2^-`digits` of itself, in odd attempts of the largest component
// of its vector; zeros and whole numbers, kinds, indices and bits stay, and so do signs.
void move_inputs(const Signature& signature, std::uint64_t index, std::uint64_t attempt, int digits,
                 const double* numbers, double* moved);

} // namespace stability
