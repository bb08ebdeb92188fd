// What a program needs to run the rows of tests/shared_rows.h in several kinds of numbers. For each kind, in a
// namespace of its own that holds the shared source: ROW_READERS, shared_inputs.h, ROW_TABLES, then the rows; they
// become functions row_NAME() that read row_in and write row_out. The program says row_tables() and calls each
// fill_tables() once.
#pragma once
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

// What cloth_fetch reads. Yarns and lights are rows of numbers in the order of tests/shared_inputs.h; heights and ASGs
// are the same for both sides, and empty where no row looks at them.
struct RowTables {
    glm::ivec2 size{0}, environment_size{0};
    std::vector<glm::uvec2> texels[2], horizons[2], inversion;
    std::vector<glm::uint> mips[2];
    std::vector<std::uint16_t> heights;
    std::vector<float> asg, yarns, lights, environment, emitters;
};
const RowTables& row_tables();

inline constexpr int row_yarn_numbers = 17, row_light_numbers = 19, row_emitter_numbers = 13;

inline thread_local const double* row_in;
inline thread_local double* row_out;

// Each kind of numbers has its own tables and readers; the text of the rows is one.
#define ROW_READERS                                                                                                    \
    namespace                                                                                                          \
    {                                                                                                                  \
    std::vector<ClothYarn> yarn_table;                                                                                 \
    std::vector<ClothLight> light_table;                                                                               \
    std::vector<ClothEmitter> emitter_table;                                                                           \
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
        const RowTables& tables = row_tables();                                                                        \
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
        const RowTables& tables = row_tables();                                                                        \
        ClothLights lights;                                                                                            \
        lights.count = static_cast<int>(light_table.size());                                                           \
        lights.environment_size = tables.environment_size;                                                             \
        lights.lights = light_table.data();                                                                            \
        lights.environment = environment_table.data();                                                                 \
        lights.inversion = tables.inversion.data();                                                                    \
        lights.emitters = emitter_table.data();                                                                        \
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

#define ROW_TABLES                                                                                                     \
    static void fill_tables()                                                                                          \
    {                                                                                                                  \
        const RowTables& tables = row_tables();                                                                        \
        const auto four = [] { return real4(in1(0), in1(1), in1(2), in1(3)); };                                        \
        fill(yarn_table, tables.yarns, row_yarn_numbers, [] { return in_yarn(0); });                                   \
        fill(light_table, tables.lights, row_light_numbers, [] { return in_light(0); });                               \
        fill(emitter_table, tables.emitters, row_emitter_numbers, [] { return in_emitter(0); });                       \
        fill(environment_table, tables.environment, 4, four);                                                          \
        fill(asg_table, tables.asg, 4, four);                                                                          \
    }

#define ROW(name, inputs, outputs, ...)                                                                                \
    static void row_##name()                                                                                           \
    {                                                                                                                  \
        __VA_ARGS__                                                                                                    \
    }
