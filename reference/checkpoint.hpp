// The state of an unfinished picture on disk, so that a later run goes on with the same bits. selvedge-render includes
// it.
#pragma once

#include <optional>
#include <string>

#include "reference/integrator.hpp"

namespace selvedge
{

struct Checkpoint {
    std::uint32_t block_length = 0;
    double seconds = 0.0; // of rendering so far
    RenderState state;
};

// What a checkpoint belongs to, in words: two runs with equal text may share one.
std::string checkpoint_owner(const Scene& scene, const RenderSettings& settings);

// Whole or not touched.  throws InputError: disk full, folder gone
void write_checkpoint(const std::string& path, const std::string& owner, const Checkpoint& checkpoint);

// Nothing where there is no such file.
//   throws  InputError: damaged, or of another scene or other settings
std::optional<Checkpoint> read_checkpoint(const std::string& path, const std::string& owner);

} // namespace selvedge
