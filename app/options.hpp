// app/options.hpp: what selvedge-lookdev's command line asks for. main.cpp fills it, headless.cpp and window.cpp read
// it.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "app/preview/context.hpp"
#include "app/preview/preview.hpp"
#include "bake/json.hpp"
#include "glsl/cloth_bsdf.hpp"

namespace selvedge
{

struct LookdevOptions {
    std::string scene;
    Overrides overrides;
    std::optional<glm::ivec2> resolution; // absent: the scene's
    int footprint_samples = 1;
    bool paths = false;                           // --integrator path
    int max_depth = cloth::f32::cloth_path_depth; // of paths, surfaces that scatter
    Finding finding = Finding::automatic;
    Shading shading = Shading::automatic;
    std::set<std::string> kept; // parts that are done whether the scene needs them or not
    std::uint32_t seed = 0;
    bool json = false, quiet = false;

    // headless
    bool headless = false;
    std::vector<std::string> outputs;
    std::uint32_t frames = 0; // 0: not given, likewise spp, time and target_error
    std::uint32_t spp = 0;
    double time_s = 0;
    double target_error = 0; // of the window, too
    bool denoise = false;
    Backend backend = Backend::automatic;

    // window
    std::string screenshot; // where F12 writes
    std::uint32_t exit_after_frames = 0;

    std::map<std::string, std::string> provenance;

    // What window and headless ask of the preview alike.
    PreviewOptions for_preview() const
    {
        PreviewOptions asked;
        asked.seed = seed;
        asked.kept = kept;
        asked.finding = finding;
        asked.shading = shading;
        return asked;
    }
};

// Both return the exit status.
int run_headless(LookdevOptions options);
int run_window(const LookdevOptions& options);

} // namespace selvedge
