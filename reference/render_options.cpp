// The command line of selvedge-render.
#include "reference/render_options.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <set>

#include <CLI/CLI.hpp>

#include "bake/error.hpp"
#include "bake/image.hpp"
#include "bake/program.hpp"
#include "reference/denoise.hpp"
#include "reference/film.hpp"
#include "reference/rays.hpp"

namespace selvedge
{

namespace
{

constexpr std::uint64_t default_samples = 64;

// CLI::Range lets NaN through.
CLI::Validator between(double low, double high)
{
    return {[=](std::string& text) {
                const double value = std::strtod(text.c_str(), nullptr);
                return value >= low && value <= high
                           ? ""
                           : format_text("found %s, expected %g to %g", text.c_str(), low, high);
            },
            ""};
}

std::vector<int> parse_integers(const char* option, const std::string& text, std::size_t count, const char* form)
{
    std::vector<int> numbers;
    for (std::size_t from = 0; from <= text.size();) {
        const std::size_t comma = std::min(text.find(',', from), text.size());
        const std::string word = text.substr(from, comma - from);
        if (word.empty() || word.size() > 7 || word.find_first_not_of("0123456789") != std::string::npos) break;
        numbers.push_back(std::stoi(word));
        from = comma + 1;
    }
    const std::size_t commas = std::size_t(std::count(text.begin(), text.end(), ','));
    if (numbers.size() != count || commas + 1 != count)
        throw UsageError("%s: found '%s', expected %s", option, text.c_str(), form);
    return numbers;
}

// `later`: words of the contract that this version cannot do; they are refused, never taken for something else.
int parse_word(const char* option, const std::string& word,
               std::initializer_list<std::pair<const char*, int>> available, const std::set<std::string>& later = {})
{
    std::string known;
    for (const auto& [name, value] : available) {
        if (word == name) return value;
        known += (known.empty() ? "" : ", ") + std::string(name);
    }
    if (later.count(word))
        throw UsageError("%s: '%s' is not available in this version, expected one of %s", option, word.c_str(),
                         known.c_str());
    throw UsageError("%s: found '%s', expected one of %s", option, word.c_str(), known.c_str());
}

unsigned parse_aovs(const std::vector<std::string>& lists)
{
    unsigned bits = 0;
    for (const std::string& list : lists)
        for (std::size_t from = 0; from <= list.size();) {
            const std::size_t comma = std::min(list.find(',', from), list.size());
            const std::string word = list.substr(from, comma - from);
            from = comma + 1;
            if (word == "variance" || word == "samples") continue; // always there
            std::string known;
            bool found = false;
            for (int k = 0; k < aov_count; ++k) {
                if (word == aov_rows[k].name) bits |= 1u << k, found = true;
                known += std::string(aov_rows[k].name) + ", ";
            }
            if (!found)
                throw UsageError("--aov: found '%s', expected some of %svariance, samples", word.c_str(),
                                 known.c_str());
        }
    return bits;
}

std::string aov_help()
{
    std::string help = "NAME,...: further layers (variance and samples are always there).";
    for (const AovRow& row : aov_rows) help += format_text(" %s: %s.", row.name, row.help);
    return help;
}

} // namespace

RenderOptions parse_render_options(int argc, char** argv, bool& done)
{
    RenderOptions options;
    std::string integrator, mis = "on", geometry = "surface", resolution, region, turn, frames;
    int turntable = 0;
    std::vector<std::string> aovs;
    bool version = false;
    CLI::App app("Renders a scene of cloth with the reference: shared shading source, Embree rays.", render_program);
    app.add_option("scene", options.scene, "SCENE.json");
    app.add_option("-o,--output", options.outputs, "OUT.exr (all layers) or OUT.png (display transform); repeatable")
        ->allow_extra_args(false);
    app.add_option("--spp", options.samples, "stop after N samples per pixel (default 64 where nothing else ends it)")
        ->check(between(1, double(sample_limit)));
    app.add_option("--time", options.time_s, "stop after SECONDS of rendering")->check(between(1e-3, 1e9));
    app.add_option("--target-error", options.target_error,
                   "stop about this estimated relMSE; samples go where they lower it most")
        ->check(between(1e-12, 1e6));
    app.add_option("--integrator", integrator, "direct (default), path (default of --model plies)");
    app.add_option("--max-depth", options.max_depth,
                   "path: surfaces that scatter along a path, 1 to 1024 (default 32; 1 is direct)")
        ->check(between(1, 1024));
    app.add_option("--mis", mis,
                   "on (default): lights with extent are looked for by BSDF sampling, too; off: by light sampling "
                   "alone, the same mean with more noise");
    options.model.add_to(app);
    app.add_option("--model", geometry,
                   "surface (default), plies: traces the plies themselves, fabrics on planes and cylinders only");
    app.add_option("--seed", options.seed, "of all random numbers (default 0)")->check(between(0, 4294967295.0));
    app.add_option("--threads", options.threads, "threads (default: all cores)")->check(between(1, 1024));
    app.add_option("--resolution", resolution, "WIDTH,HEIGHT instead of the scene's");
    app.add_option("--region", region,
                   "X0,Y0,X1,Y1: only pixels X0 <= x < X1, Y0 <= y < Y1; the rest of the picture stays 0");
    app.add_flag("--denoise", options.denoise, denoise_help);
    app.add_option("--aov", aovs, aov_help())->allow_extra_args(false);
    app.add_option("--turntable", turntable, "N pictures of one turn about the vertical: OUT_0000, OUT_0001, ...")
        ->check(between(1, 100000));
    app.add_option("--turn", turn,
                   "what --turntable turns: objects (default; those that do not shine), camera, lights");
    app.add_option("--frames", frames,
                   "FIRST-LAST: pictures OUT_FIRST to OUT_LAST of the turntable, or of -D values that hold {frame} or, "
                   "with 4 digits, {frame:4}");
    app.add_flag(
        "--resume", options.resume,
        "go on from the checkpoint beside OUT, where there is one; pictures of a sequence that are complete stay");
    app.add_option("--checkpoint", options.checkpoint_s, "write OUT.checkpoint every SECONDS and at the end")
        ->check(between(1e-3, 1e9));
    app.add_option("-D", options.overrides,
                   "path.to.key=value: overrides a value of the scene, or of fabrics (fabric.KEY for all, "
                   "objects.N.fabric.KEY for one)")
        ->allow_extra_args(false);
    app.add_flag("--json", options.json, "one JSON object on stdout");
    app.add_flag("-q,--quiet", options.quiet, "no progress, no warnings, no summary");
    app.add_flag("-V,--version", version, "version, git revision, libraries");
    if (!parse_command_line(app, argc, argv)) {
        done = true;
        return options;
    }
    if (version) {
        std::map<std::string, std::string> libraries = image_library_versions();
        libraries["Embree"] = embree_version();
        std::fputs(version_text(render_program, libraries).c_str(), stdout);
        done = true;
        return options;
    }
    if (options.scene.empty()) throw UsageError("no scene, expected SCENE.json");
    if (options.outputs.empty()) throw UsageError("no -o, expected OUT.exr or OUT.png");
    options.plies = parse_word("--model", geometry, {{"surface", 0}, {"plies", 1}}) == 1;
    if (integrator.empty()) integrator = options.plies ? "path" : "direct";
    if (options.plies && options.model.says_anything())
        throw UsageError("--model plies: found --mode, --bsdf or --visibility, which are the surface model's");
    options.integrator = Integrator(
        parse_word("--integrator", integrator, {{"direct", int(Integrator::direct)}, {"path", int(Integrator::path)}}));
    options.mis = parse_word("--mis", mis, {{"off", 0}, {"on", 1}}) == 1;
    if (options.plies && !options.mis) throw UsageError("--model plies: found --mis off, which is the surface model's");
    options.model.prepend_to(options.overrides);
    if (!resolution.empty()) {
        const std::vector<int> n = parse_integers("--resolution", resolution, 2, "WIDTH,HEIGHT");
        if (n[0] < 1 || n[1] < 1 || n[0] > 16384 || n[1] > 16384)
            throw UsageError("--resolution: found '%s', expected 1 to 16384 each", resolution.c_str());
        options.resolution = {n[0], n[1]};
    }
    if (!region.empty()) {
        const std::vector<int> n = parse_integers("--region", region, 4, "X0,Y0,X1,Y1");
        options.region = {n[0], n[1], n[2], n[3]};
    }
    options.aovs = parse_aovs(aovs);
    if (options.plies && options.aovs & (aov_terms | aov_visibility))
        throw UsageError("--model plies: found a layer of the surface model in --aov, expected albedo, normal, depth, "
                         "uv, object, fabric or yarn");
    options.sequence = parse_sequence(turntable, turn, frames, options.overrides);
    for (const std::string& path : options.outputs) check_result_path(path);
    if (options.samples == 0 && options.time_s == 0.0 && options.target_error == 0.0) options.samples = default_samples;
    return options;
}

} // namespace selvedge
