// tests/cpp/stability_functions.cpp: the rows in four kinds of numbers.
#include "tests/cpp/stability_functions.hpp"

#include "cloth_bsdf.hpp"
#include "tests/cpp/stability_inputs.hpp"
#include "tests/cpp/stability_traced.hpp"

namespace
{

thread_local const double* row_in;
thread_local double* row_out;

} // namespace

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

// Each kind of numbers has its own tables and readers; the text of the rows is one.
#define READERS                                                                                                        \
    namespace                                                                                                          \
    {                                                                                                                  \
    std::vector<ClothYarn> yarn_table;                                                                                 \
    std::vector<ClothLight> light_table;                                                                               \
    std::vector<real4> environment_table, asg_table;                                                                   \
    inline real in1(int k)                                                                                             \
    {                                                                                                                  \
        return static_cast<real>(row_in[k]);                                                                           \
    }                                                                                                                  \
    inline void out1(int k, real v)                                                                                    \
    {                                                                                                                  \
        row_out[k] = static_cast<double>(v);                                                                           \
    }                                                                                                                  \
    ClothMaps in_maps()                                                                                                \
    {                                                                                                                  \
        const stability::Tables& tables = stability::tables();                                                         \
        ClothMaps maps;                                                                                                \
        maps.size = tables.size;                                                                                       \
        for (int side = 0; side < 2; ++side) {                                                                         \
            maps.texels[side] = tables.texels[side].data();                                                            \
            maps.horizons[side] = tables.horizons[side].data();                                                        \
            maps.mips[side] = tables.mips[side].data();                                                                \
            maps.heights[side] = tables.heights.data();                                                                \
            maps.asg[side] = asg_table.data();                                                                         \
        }                                                                                                              \
        maps.yarns = yarn_table.data();                                                                                \
        return maps;                                                                                                   \
    }                                                                                                                  \
    ClothLights in_lights()                                                                                            \
    {                                                                                                                  \
        const stability::Tables& tables = stability::tables();                                                         \
        ClothLights lights;                                                                                            \
        lights.count = static_cast<int>(light_table.size());                                                           \
        lights.environment_size = tables.environment_size;                                                             \
        lights.lights = light_table.data();                                                                            \
        lights.environment = environment_table.data();                                                                 \
        lights.alias = tables.alias.data();                                                                            \
        return lights;                                                                                                 \
    }                                                                                                                  \
    template <class Item, class Read>                                                                                  \
    void fill(std::vector<Item>& items, const std::vector<float>& from, int width, Read read)                          \
    {                                                                                                                  \
        const std::vector<double> numbers(from.begin(), from.end());                                                   \
        for (row_in = numbers.data(); row_in != numbers.data() + numbers.size(); row_in += width)                      \
            items.push_back(read());                                                                                   \
    }                                                                                                                  \
    }

#define FILL                                                                                                           \
    static void fill_tables()                                                                                          \
    {                                                                                                                  \
        const stability::Tables& tables = stability::tables();                                                         \
        const auto four = [] { return real4(in1(0), in1(1), in1(2), in1(3)); };                                        \
        fill(yarn_table, tables.yarns, stability::yarn_numbers, [] { return in_yarn(0); });                            \
        fill(light_table, tables.lights, stability::light_numbers, [] { return in_light(0); });                        \
        fill(environment_table, tables.environment, 4, four);                                                          \
        fill(asg_table, tables.asg, 4, four);                                                                          \
    }

#define ROW(name, inputs, outputs, ...)                                                                                \
    static void row_##name()                                                                                           \
    {                                                                                                                  \
        __VA_ARGS__                                                                                                    \
    }

namespace cloth::f32
{
READERS
#include "tests/shared_inputs.h"
FILL
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
} // namespace cloth::f32

namespace cloth::f64
{
READERS
#include "tests/shared_inputs.h"
FILL
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
} // namespace cloth::f64

namespace cloth::noted_f32
{
READERS
#include "tests/shared_inputs.h"
FILL
#include "tests/cpp/stability_rows.hpp"
#include "tests/shared_rows.h"
} // namespace cloth::noted_f32

namespace cloth::noted_f64
{
READERS
#include "tests/shared_inputs.h"
FILL
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
