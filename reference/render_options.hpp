// What selvedge-render's command line asks for. render_main.cpp includes it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "reference/integrator.hpp"
#include "reference/model.hpp"
#include "reference/sequence.hpp"

namespace selvedge
{

inline constexpr const char* render_program = "selvedge-render";
inline constexpr std::uint64_t sample_limit = 1u << 24; // counts stay exact in the float layer `samples`

struct RenderOptions {
    std::string scene;
    std::vector<std::string> outputs;
    std::uint64_t samples = 0; // 0: no limit
    double time_s = 0.0;       // 0: no limit
    double target_error = 0.0; // 0: no limit
    Integrator integrator = Integrator::direct;
    int max_depth = cloth::f32::cloth_path_depth;
    bool mis = true;
    ModelOptions model;
    bool plies = false; // --model plies
    std::uint32_t seed = 0;
    int threads = 0;             // 0: all
    glm::ivec2 resolution{0, 0}; // 0: the scene's
    glm::ivec4 region{-1};       // -1: all
    unsigned aovs = 0;
    bool denoise = false;
    bool resume = false, json = false, quiet = false;
    double checkpoint_s = 0.0; // 0: no checkpoints
    Overrides overrides;
    Sequence sequence;
};

// Prints --help and --version itself; `done` is then true and the options mean nothing.
//   throws  UsageError; InputError where an output has no place to go
RenderOptions parse_render_options(int argc, char** argv, bool& done);

} // namespace selvedge
