// Which ingredients of the model are evaluated, by name: the scene's "model" object, --mode, --bsdf, --visibility and
// -D model.KEY=value all end here. Programs, the window and reports include it.
#pragma once

#include <string>

#include "bake/json.hpp"
#include "bake/pack.hpp"
#include "glsl/cloth_bsdf.hpp"

namespace selvedge
{

struct ModelSpec {
    cloth::f32::ClothSettings settings{};
    // What the bake has to provide; the shader's settings know no more than the kind of look-up.
    VisibilityKind visibility = VisibilityKind::horizon8;
    bool stacked = true; // light that has crossed one yarn meets the next: the yarns' numbers say it (shade_yarns)
};

// The presets: "ours" (relief, horizons, unscattered light, stacked yarns, interreflection, twist noise) and "paper"
// (weights from the slope mips, ASG as written, nothing else), "jin" (Jin et al. 2022: the plies' slab with the cosines
// of the macroscopic normal, math.md 3.5, no shadowing or masking).
ModelSpec model_preset(const std::string& mode);

// "model": {"mode", "bsdf", "weight", "visibility", "slab", "unscattered", "stacked", "interreflection",
// "twist_noise"}; keys
// beside "mode" change the preset.
//   throws  InputError with file, line and key
ModelSpec parse_model(const JsonValue& value);

// The same as JSON, every key filled in: for reports and hashes.
nlohmann::json model_json(const ModelSpec& model);

// The programs' options: --mode, --bsdf, --visibility. After parsing, `overrides` begins with what they say.
struct ModelOptions {
    std::string mode, bsdf, visibility;        // empty: as the scene says
    template <class App> void add_to(App& app) // a CLI::App
    {
        app.add_option("--mode", mode,
                       "ours (default), paper, jin: all ingredients of the model; single ones by -D model.KEY=value");
        app.add_option("--bsdf", bsdf, "meso (default), micro (the ply-level baseline without shadowing and masking)");
        app.add_option("--visibility", visibility, "horizon8 (default), horizon16, cap, asg, asg-lsq, exact, none");
    }
    bool says_anything() const { return !mode.empty() || !bsdf.empty() || !visibility.empty(); }
    void prepend_to(Overrides& overrides) const; // throws UsageError for an unknown word
};

} // namespace selvedge
