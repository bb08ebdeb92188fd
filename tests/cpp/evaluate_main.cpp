// selvedge-evaluate: runs one row of tests/shared_rows.h as C++ float or double. Numbers in and out are raw float64:
//   selvedge-evaluate ROW f32|f64 [TABLES] < rows > results        TABLES: maps and lights, as tests/evaluate.py writes
//   them
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "cloth_bsdf.hpp"
#include "tests/cpp/row_readers.hpp"

namespace
{

// As tests/evaluate.py writes them: see Tables.write there.
RowTables tables;

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
    read_items(file, tables.inversion);
    read_items(file, tables.heights);
    read_items(file, tables.asg);
    read_items(file, tables.emitters);
    std::fclose(file);
}

struct Row {
    const char* name;
    int inputs, outputs;
    void (*f32)();
    void (*f64)();
};

} // namespace

const RowTables& row_tables()
{
    return tables;
}

namespace cloth::f32
{
ROW_READERS
#include "tests/shared_inputs.h"
ROW_TABLES
#include "tests/shared_rows.h"
} // namespace cloth::f32
namespace cloth::f64
{
ROW_READERS
#include "tests/shared_inputs.h"
ROW_TABLES
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
        cloth::f32::fill_tables();
        cloth::f64::fill_tables();
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
