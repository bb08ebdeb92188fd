// selvedge-lookdev: the OpenGL preview, in a window or headless. Exit 0 done, 1 input, I/O or GL failed, 2 wrong usage.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <set>

#include <CLI/CLI.hpp>

#include "app/options.hpp"
#include "app/preview/needs.hpp"
#include "app/window.hpp"
#include "bake/error.hpp"
#include "bake/image.hpp"
#include "bake/program.hpp"
#include "reference/denoise.hpp"
#include "reference/film.hpp"
#include "reference/model.hpp"
#include "reference/rays.hpp"

namespace
{

using namespace selvedge;

constexpr const char* program = "selvedge-lookdev";

// CLI::Range lets NaN through.
CLI::Validator between(double low, double high)
{
    return {[=](std::string& text) {
                char* end = nullptr;
                const double value = std::strtod(text.c_str(), &end);
                return end != text.c_str() && *end == '\0' && value >= low && value <= high
                           ? ""
                           : format_text("found %s, expected %g to %g", text.c_str(), low, high);
            },
            ""};
}

glm::ivec2 parse_resolution(const std::string& text)
{
    int x = 0, y = 0, end = 0;
    if (std::sscanf(text.c_str(), "%d,%d%n", &x, &y, &end) != 2 || text[static_cast<std::size_t>(end)] != '\0' ||
        x < 1 || y < 1 || x > 16384 || y > 16384)
        throw UsageError("--resolution: found '%s', expected WIDTH,HEIGHT, each 1 to 16384", text.c_str());
    return {x, y};
}

std::string gl_backends()
{
    std::string text;
    for (const auto& [name, backend] : {std::pair{"egl", Backend::egl}, {"osmesa", Backend::osmesa}}) {
        try {
            const auto context = Context::create(backend);
            text += format_text("GL back end %s: %s, %s\n", name, context->info.renderer.c_str(),
                                context->info.version.c_str());
        } catch (const std::exception& error) {
            text += format_text("GL back end %s: not available: %s\n", name, error.what());
        }
    }
    return text;
}

std::string list_of(const std::vector<std::string>& words)
{
    std::string text;
    for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
    return text;
}

// What a word of an option stands for.
template <typename Value>
Value value_of(const char* option, const std::string& word, const std::vector<std::pair<std::string, Value>>& values)
{
    std::vector<std::string> words;
    for (const auto& [name, value] : values) {
        if (name == word) return value;
        words.push_back(name);
    }
    throw UsageError("%s: '%s' is unknown, expected %s", option, word.c_str(), list_of(words).c_str());
}

LookdevOptions parse_options(int argc, char** argv, bool& done)
{
    using namespace cloth::f32;
    LookdevOptions options;
    std::string resolution, backend = "auto", integrator = "direct", finding = "auto", shading = "auto";
    std::vector<std::string> kept;
    ModelOptions model;
    bool version = false;
    CLI::App app("Shows a scene of cloth in a window that converges to the reference; --headless writes the picture.",
                 program);
    app.add_option("scene", options.scene, "SCENE.json");
    app.add_flag("--headless", options.headless, "no window: write a picture");
    app.add_option("-o,--output", options.outputs,
                   "headless: OUT.exr (all layers) or OUT.png (display transform); repeatable")
        ->allow_extra_args(false);
    app.add_option("--frames", options.frames,
                   "headless: stop after N frames (--footprint-samples samples of every pixel each)")
        ->check(between(1, 16777216));
    app.add_option("--spp", options.spp,
                   "headless: stop after N samples of every pixel, in frames of up to 32: the quickest way to them")
        ->check(between(1, 16777216));
    app.add_option("--time", options.time_s, "headless: stop after SECONDS of rendering")->check(between(1e-3, 1e9));
    app.add_option("--target-error", options.target_error,
                   "stop at this estimated relMSE, tile by tile (window: default what a display cannot show)")
        ->check(between(1e-12, 1e6));
    app.add_flag("--denoise", options.denoise, "headless: " + std::string(denoise_help));
    app.add_option("--resolution", resolution, "WIDTH,HEIGHT instead of the scene's");
    app.add_option("--backend", backend, "headless: auto (EGL, then OSMesa), egl, osmesa");
    app.add_option("--integrator", integrator, "direct (default), path: with light that bounces");
    app.add_option("--max-depth", options.max_depth,
                   "path: surfaces that scatter along a path, 1 to 1024 (default 32; 1 is direct)")
        ->check(between(1, 1024));
    model.add_to(app);
    app.add_option("--footprint-samples", options.footprint_samples,
                   "samples of every pixel in a frame, of one ray (default 1)")
        ->check(between(1, 64));
    app.add_option("--primary", finding,
                   "how pixels find what they see: auto (default: rays where software GL has few pixels for a "
                   "triangle), raster, rays");
    app.add_option("--shade", shading,
                   "what shades pixels: auto (default: compute shaders on a card that has them), fragment, compute");
    app.add_option("--keep", kept,
                   "do a part's work whether the scene needs it or not, for comparison: " + list_of(skip_names()) +
                       ", all; repeatable")
        ->allow_extra_args(false);
    app.add_option("--seed", options.seed, "of all random numbers (default 0)")->check(between(0, 4294967295.0));
    app.add_option("-D", options.overrides,
                   "path.to.key=value: overrides a value of the scene or (fabric.KEY) its fabrics")
        ->allow_extra_args(false);
    app.add_option("--screenshot", options.screenshot, "window: where F12 writes (default selvedge.png)");
    app.add_option("--exit-after-frames", options.exit_after_frames, "window: close by itself")
        ->check(between(1, 16777216));
    app.add_flag("--json", options.json, "headless: one JSON object on stdout");
    app.add_flag("-q,--quiet", options.quiet, "no progress, no warnings");
    app.add_flag("-V,--version", version, "version, git revision, libraries, GL back ends");
    if (!parse_command_line(app, argc, argv)) {
        done = true;
        return options;
    }
    if (version) {
        std::map<std::string, std::string> libraries = image_library_versions();
        libraries["Embree"] = embree_version();
        libraries.merge(window_library_versions());
        std::fputs((version_text(program, libraries) + gl_backends()).c_str(), stdout);
        done = true;
        return options;
    }
    if (options.scene.empty()) throw UsageError("no scene, expected SCENE.json");
    if (!resolution.empty()) options.resolution = parse_resolution(resolution);
    options.backend = parse_backend(backend);
    options.finding = value_of<Finding>(
        "--primary", finding, {{"auto", Finding::automatic}, {"raster", Finding::raster}, {"rays", Finding::rays}});
    options.shading = value_of<Shading>(
        "--shade", shading,
        {{"auto", Shading::automatic}, {"fragment", Shading::fragment}, {"compute", Shading::compute}});
    for (const std::string& name : kept) {
        const std::vector<std::string>& known = skip_names();
        if (name == "all")
            options.kept.insert(known.begin(), known.end());
        else if (std::find(known.begin(), known.end(), name) != known.end())
            options.kept.insert(name);
        else
            throw UsageError("--keep: '%s' is unknown, expected one of %s, all", name.c_str(), list_of(known).c_str());
    }
    if (integrator != "direct" && integrator != "path")
        throw UsageError("--integrator: '%s' is unknown, expected direct or path", integrator.c_str());
    options.paths = integrator == "path";
    model.prepend_to(options.overrides);
    if (options.spp > 0 && (options.frames > 0 || options.footprint_samples > 1))
        throw UsageError(
            "--spp says how many frames of how many samples there are, found --frames or --footprint-samples");
    const bool stops = options.frames > 0 || options.spp > 0 || options.time_s > 0 || options.target_error > 0;
    if (options.headless) {
        if (options.outputs.empty()) throw UsageError("--headless without -o, expected OUT.exr or OUT.png");
        if (!stops) throw UsageError("--headless without an end, expected --frames, --spp, --time or --target-error");
        if (options.exit_after_frames > 0 || !options.screenshot.empty())
            throw UsageError("--exit-after-frames and --screenshot are for the window, found --headless");
    } else if (options.frames > 0 || options.spp > 0 || options.time_s > 0 || !options.outputs.empty() ||
               options.denoise || options.json || backend != "auto") {
        throw UsageError("-o, --frames, --spp, --time, --denoise, --backend and --json need --headless");
    }
    for (const std::string& path : options.outputs) check_result_path(path);
    if (options.screenshot.empty()) options.screenshot = "selvedge.png";
    options.provenance = provenance(argc, argv);
    return options;
}

} // namespace

int main(int argc, char** argv)
{
    return run_program(program, [&] {
        bool done = false;
        const LookdevOptions options = parse_options(argc, argv, done);
        if (done) return 0;
        return options.headless ? run_headless(options) : run_window(options);
    });
}
