// app/preview/program_cache.hpp: linked GL programs on disk, beside the baked fabrics. Included by shader_source.cpp.
#pragma once

#include <string>
#include <vector>

#include "gl.hpp"

namespace selvedge
{

// How many programs of this process came from the disk, and how many had to be compiled.
struct ProgramCounts {
    int compiled = 0, cached = 0;
};
ProgramCounts& program_counts();

// Name of a program in the cache: hash of its sources and of everything that the driver says of itself.
std::string program_key(const std::vector<std::string>& stage_texts);

// Loads a program into `program`. False where the cache has none, it is damaged, or the driver refuses it: it is
// compiled then. Leaves no GL error behind.
bool read_program(const std::string& key, GLuint program);

// Stores a linked program; a cache that cannot be written and a driver without binaries are no errors.
void write_program(const std::string& key, GLuint program);

} // namespace selvedge
