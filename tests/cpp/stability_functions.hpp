// The functions under test: the rows of tests/shared_rows.h and stability_rows.hpp, as the shipped float and double
// code and as the same text with numbers that note every decision.
#pragma once
#include <cstdint>
#include <vector>

namespace stability
{

struct Function {
    const char* name;
    int inputs, outputs;
    // in: `inputs` numbers, out: `outputs` numbers. From any thread.
    void (*f32)(const double* in, double* out);
    void (*f64)(const double* in, double* out);
    // The same in numbers that note; returns the hash of all decisions.
    std::uint64_t (*noted_f32)(const double* in, double* out);
    std::uint64_t (*noted_f64)(const double* in, double* out);
};

// Reads the tables on the first call, which is not for several threads at once.
const std::vector<Function>& functions();

} // namespace stability
