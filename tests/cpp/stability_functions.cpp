// tests/cpp/stability_functions.cpp: the rows in four kinds of numbers.
#include "tests/cpp/stability_functions.hpp"

#include "cloth_bsdf.hpp"
#include "tests/cpp/row_readers.hpp"
#include "tests/cpp/stability_inputs.hpp"
#include "tests/cpp/stability_traced.hpp"

// The shared source once more, in numbers that note their decisions. Functions of Traced and its vectors are found
// beside it.
namespace cloth::noted_f32
{
using namespace glm;
using real = stability::Traced<float>;
using real2 = stability::Vector<2, float>;
using real3 = stability::Vector<3, float>;
using real4 = stability::Vector<4, float>;
#include "cloth.h"
} // namespace cloth::noted_f32

namespace cloth::noted_f64
{
using namespace glm;
using real = stability::Traced<double>;
using real2 = stability::Vector<2, double>;
using real3 = stability::Vector<3, double>;
using real4 = stability::Vector<4, double>;
#include "cloth.h"
} // namespace cloth::noted_f64

namespace cloth::f32
{
ROW_READERS
#include "tests/shared_inputs.h"
ROW_TABLES
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
} // namespace cloth::f32

namespace cloth::f64
{
ROW_READERS
#include "tests/shared_inputs.h"
ROW_TABLES
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
} // namespace cloth::f64

namespace cloth::noted_f32
{
ROW_READERS
#include "tests/shared_inputs.h"
ROW_TABLES
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
} // namespace cloth::noted_f32

namespace cloth::noted_f64
{
ROW_READERS
#include "tests/shared_inputs.h"
ROW_TABLES
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
} // namespace cloth::noted_f64

#undef ROW

namespace stability
{

template <void (*row)()> static void call(const double* in, double* out)
{
    row_in = in;
    row_out = out;
    row();
}

template <void (*row)()> static std::uint64_t call_noted(const double* in, double* out)
{
    trail = 0;
    call<row>(in, out);
    return trail;
}

const std::vector<Function>& functions()
{
    static const std::vector<Function> all = [] {
        cloth::f32::fill_tables();
        cloth::f64::fill_tables();
        cloth::noted_f32::fill_tables();
        cloth::noted_f64::fill_tables();
        return std::vector<Function>{
#define ROW(name, inputs, outputs, ...)                                                                                \
    {#name,                                                                                                            \
     inputs,                                                                                                           \
     outputs,                                                                                                          \
     call<cloth::f32::row_##name>,                                                                                     \
     call<cloth::f64::row_##name>,                                                                                     \
     call_noted<cloth::noted_f32::row_##name>,                                                                         \
     call_noted<cloth::noted_f64::row_##name>},
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
#undef ROW
        };
    }();
    return all;
}

} // namespace stability
