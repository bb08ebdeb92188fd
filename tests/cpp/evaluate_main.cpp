// selvedge-evaluate: runs one row of tests/shared_rows.h as C++ float or double. Numbers in and out are raw float64:
//   selvedge-evaluate ROW f32|f64 [TABLES] < rows > results        TABLES: maps and lights, as tests/evaluate.py writes
//   them
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "cloth_bsdf.hpp"

namespace
{

const double* row_in;
double* row_out;

// The words of TABLES, in its order; see Tables.write in tests/evaluate.py.
struct Tables {
    glm::ivec2 size{0}, environment_size{0};
    std::vector<glm::uvec2> texels[2], horizons[2], alias;
    std::vector<glm::uint> mips[2];
    std::vector<float> yarns, lights, environment;
} tables;

template <class Item> void read_items(std::FILE* file, std::vector<Item>& items)
{
    std::uint32_t count = 0;
    if (std::fread(&count, 4, 1, file) == 1) items.resize(count);
    if (count > 0 && std::fread(items.data(), sizeof(Item), count, file) != count)
        std::perror("selvedge-evaluate: tables");
}

void read_tables(const char* path)
{
    std::FILE* file = std::fopen(path, "rb");
    std::vector<int> sizes;
    if (!file) return std::perror(path);
    read_items(file, sizes);
    tables.size = {sizes.at(0), sizes.at(1)};
    tables.environment_size = {sizes.at(2), sizes.at(3)};
    for (int side = 0; side < 2; ++side) read_items(file, tables.texels[side]);
    for (int side = 0; side < 2; ++side) read_items(file, tables.horizons[side]);
    for (int side = 0; side < 2; ++side) read_items(file, tables.mips[side]);
    read_items(file, tables.yarns);
    read_items(file, tables.lights);
    read_items(file, tables.environment);
    read_items(file, tables.alias);
    std::fclose(file);
}

struct Row {
    const char* name;
    int inputs, outputs;
    void (*f32)();
    void (*f64)();
};

} // namespace

// Each precision has its own tables, readers and rows; the text of the rows is one.
#define ROWS_IN_PRECISION                                                                                              \
    namespace                                                                                                          \
    {                                                                                                                  \
    std::vector<ClothYarn> yarn_table;                                                                                 \
    std::vector<ClothLight> light_table;                                                                               \
    std::vector<real4> environment_table;                                                                              \
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
        ClothMaps maps;                                                                                                \
        maps.size = tables.size;                                                                                       \
        for (int side = 0; side < 2; ++side) {                                                                         \
            maps.texels[side] = tables.texels[side].data();                                                            \
            maps.horizons[side] = tables.horizons[side].data();                                                        \
            maps.mips[side] = tables.mips[side].data();                                                                \
        }                                                                                                              \
        maps.yarns = yarn_table.data();                                                                                \
        return maps;                                                                                                   \
    }                                                                                                                  \
    ClothLights in_lights()                                                                                            \
    {                                                                                                                  \
        ClothLights lights;                                                                                            \
        lights.count = static_cast<int>(light_table.size());                                                           \
        lights.environment_size = tables.environment_size;                                                             \
        lights.lights = light_table.data();                                                                            \
        lights.environment = environment_table.data();                                                                 \
        lights.alias = tables.alias.data();                                                                            \
        return lights;                                                                                                 \
    }                                                                                                                  \
    }

namespace cloth::f32
{
ROWS_IN_PRECISION
#include "tests/shared_inputs.h"
#define ROW(name, inputs, outputs, ...)                                                                                \
    static void row_##name()                                                                                           \
    {                                                                                                                  \
        __VA_ARGS__                                                                                                    \
    }
#include "tests/shared_rows.h"
} // namespace cloth::f32
namespace cloth::f64
{
ROWS_IN_PRECISION
#include "tests/shared_inputs.h"
#include "tests/shared_rows.h"
} // namespace cloth::f64
#undef ROW

namespace
{

const Row rows[] = {
#define ROW(name, inputs, outputs, ...) {#name, inputs, outputs, cloth::f32::row_##name, cloth::f64::row_##name},
#include "tests/shared_rows.h"
#undef ROW
};

// Yarns and lights travel as rows of numbers, as the rows themselves read them.
template <class Yarn, class Read>
void read_structs(std::vector<Yarn>& out, const std::vector<float>& numbers, int width, Read read)
{
    std::vector<double> wide(numbers.begin(), numbers.end());
    for (std::size_t first = 0; first + static_cast<std::size_t>(width) <= wide.size();
         first += static_cast<std::size_t>(width)) {
        row_in = wide.data() + first;
        out.push_back(read());
    }
}

void fill_tables()
{
    read_structs(cloth::f32::yarn_table, tables.yarns, 17, [] { return cloth::f32::in_yarn(0); });
    read_structs(cloth::f64::yarn_table, tables.yarns, 17, [] { return cloth::f64::in_yarn(0); });
    read_structs(cloth::f32::light_table, tables.lights, 19, [] { return cloth::f32::in_light(0); });
    read_structs(cloth::f64::light_table, tables.lights, 19, [] { return cloth::f64::in_light(0); });
    read_structs(cloth::f32::environment_table, tables.environment, 4,
                 [] { return glm::vec4(cloth::f32::in3(0), cloth::f32::in1(3)); });
    read_structs(cloth::f64::environment_table, tables.environment, 4,
                 [] { return glm::dvec4(cloth::f64::in3(0), cloth::f64::in1(3)); });
}

} // namespace

int main(int argc, char** argv)
{
    if (argc < 3 || argc > 4 || (std::strcmp(argv[2], "f32") != 0 && std::strcmp(argv[2], "f64") != 0)) {
        std::fprintf(stderr, "usage: selvedge-evaluate ROW f32|f64 [TABLES] < rows > results\n");
        return 2;
    }
    for (const Row& row : rows) {
        if (std::strcmp(row.name, argv[1]) != 0) continue;
        if (argc == 4) read_tables(argv[3]);
        fill_tables();
        std::vector<double> in(static_cast<std::size_t>(row.inputs)), out(static_cast<std::size_t>(row.outputs));
        while (std::fread(in.data(), sizeof(double), in.size(), stdin) == in.size()) {
            row_in = in.data();
            row_out = out.data();
            (std::strcmp(argv[2], "f32") == 0 ? row.f32 : row.f64)();
            if (std::fwrite(out.data(), sizeof(double), out.size(), stdout) != out.size()) return 1;
        }
        return 0;
    }
    std::fprintf(stderr, "selvedge-evaluate: no row %s\n", argv[1]);
    return 2;
}
