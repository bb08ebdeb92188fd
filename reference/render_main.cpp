// selvedge-render: renders one scene with the reference integrators. Exit 0 done, 1 input or I/O failed, 2 wrong usage.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <set>

#include <sys/resource.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include "bake/error.hpp"
#include "bake/image.hpp"
#include "bake/program.hpp"
#include "reference/checkpoint.hpp"
#include "reference/film.hpp"
#include "reference/integrator.hpp"
#include "reference/model.hpp"
#include "reference/plies.hpp"
#include "reference/rays.hpp"
#include "reference/scene.hpp"

namespace
{

using namespace selvedge;
namespace f32 = cloth::f32;
using Clock = std::chrono::steady_clock;

constexpr const char* program = "selvedge-render";
constexpr std::uint64_t default_samples = 64;
constexpr std::uint64_t sample_limit = 1u << 24; // counts stay exact in the float layer `samples`
constexpr double pass_seconds = 0.25;            // a pass is as many samples as fit: SIGINT and --time wait for one
constexpr double forever = std::numeric_limits<double>::infinity();

struct Options {
    std::string scene;
    std::vector<std::string> outputs;
    std::uint64_t samples = 0; // 0: no limit
    double time_s = 0.0;       // 0: no limit
    double target_error = 0.0; // 0: no limit
    Integrator integrator = Integrator::direct;
    int max_depth = 32;
    ModelOptions model;
    bool plies = false; // --model plies
    std::uint32_t seed = 0;
    int threads = 0;             // 0: all
    glm::ivec2 resolution{0, 0}; // 0: the scene's
    glm::ivec4 region{-1};       // -1: all
    unsigned aovs = 0;
    bool resume = false, json = false, quiet = false;
    double checkpoint_s = 0.0; // 0: no checkpoints
    Overrides overrides;
};

// ---- command line
// ----------------------------------------------------------------------------------------------------------

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

Options parse_options(int argc, char** argv, bool& done)
{
    Options options;
    std::string integrator, resolution, region, geometry = "surface";
    std::vector<std::string> aovs;
    bool version = false;
    CLI::App app("Renders a scene of cloth with the reference: shared shading source, Embree rays.", program);
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
    options.model.add_to(app);
    app.add_option("--model", geometry,
                   "surface (default), plies: traces the plies themselves, fabrics on planes and cylinders only");
    app.add_option("--seed", options.seed, "of all random numbers (default 0)")->check(between(0, 4294967295.0));
    app.add_option("--threads", options.threads, "threads (default: all cores)")->check(between(1, 1024));
    app.add_option("--resolution", resolution, "WIDTH,HEIGHT instead of the scene's");
    app.add_option("--region", region,
                   "X0,Y0,X1,Y1: only pixels X0 <= x < X1, Y0 <= y < Y1; the rest of the picture stays 0");
    app.add_option("--aov", aovs, aov_help())->allow_extra_args(false);
    app.add_flag("--resume", options.resume, "go on from the checkpoint beside OUT, where there is one");
    app.add_option("--checkpoint", options.checkpoint_s, "write OUT.checkpoint every SECONDS and at the end")
        ->check(between(1e-3, 1e9));
    app.add_option("-D", options.overrides,
                   "path.to.key=value: overrides a value of the scene, or of fabrics (fabric.KEY for all, "
                   "objects.N.fabric.KEY for one)")
        ->allow_extra_args(false);
    app.add_flag("--json", options.json, "one JSON object on stdout");
    app.add_flag("-q,--quiet", options.quiet, "no progress, no warnings, no summary");
    app.add_flag("-V,--version", version, "version, git revision, libraries");
    try {
        app.parse(argc, argv);
    } catch (const CLI::CallForHelp&) {
        std::fputs(app.help().c_str(), stdout);
        done = true;
        return options;
    } catch (const CLI::ParseError& error) {
        throw UsageError("%s", error.what());
    }
    if (version) {
        std::map<std::string, std::string> libraries = image_library_versions();
        libraries["Embree"] = embree_version();
        std::fputs(version_text(program, libraries).c_str(), stdout);
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
    for (const std::string& path : options.outputs) check_result_path(path);
    if (options.samples == 0 && options.time_s == 0.0 && options.target_error == 0.0) options.samples = default_samples;
    return options;
}

// ---- interruption, progress
// ------------------------------------------------------------------------------------------------

volatile std::sig_atomic_t interrupted = 0;

void on_signal(int signal)
{
    interrupted = 1;
    std::signal(signal, SIG_DFL); // a second one ends the program at once
}

double seconds_since(Clock::time_point start)
{
    return std::chrono::duration<double>(Clock::now() - start).count();
}

// One line that overwrites itself, on a terminal only.
class Progress
{
  public:
    explicit Progress(bool quiet) : shown_(!quiet && isatty(STDERR_FILENO) == 1) {}
    ~Progress() { clear(); }
    void show(double done, std::uint64_t samples, double error, double seconds)
    {
        if (!shown_) return;
        constexpr int width = 30;
        const int full = int(std::clamp(done, 0.0, 1.0) * width);
        std::string bar(std::size_t(full), '=');
        bar.resize(width, ' ');
        std::string line = format_text("\r[%s] %3d %%  %llu spp", bar.c_str(), int(100.0 * std::clamp(done, 0.0, 1.0)),
                                       static_cast<unsigned long long>(samples));
        if (std::isfinite(error)) line += format_text("  error %.2e", error);
        if (done > 0.0 && done < 1.0) line += format_text("  %.0f s left", seconds * (1.0 - done) / done);
        std::fprintf(stderr, "%s\033[K", line.c_str());
        std::fflush(stderr);
        drawn_ = true;
    }
    void clear()
    {
        if (drawn_) std::fputs("\r\033[K", stderr);
        drawn_ = false;
    }

  private:
    bool shown_, drawn_ = false;
};

// ---- the job
// ---------------------------------------------------------------------------------------------------------------

struct Outcome {
    std::unique_ptr<Renderer> renderer;
    RenderState state;
    double seconds = 0.0; // of rendering, those before a resume included
    double resumed_seconds = 0.0;
    std::uint64_t resumed_samples = 0;
    double resumed_samples_mean = 0.0; // per pixel, where adaptive sampling has stopped some
    double error = std::numeric_limits<double>::quiet_NaN();
    const char* stopped_by = "samples";
};

RenderSettings settings_of(const Options& options, const Scene& scene)
{
    RenderSettings settings;
    settings.integrator = options.integrator;
    settings.max_depth = options.max_depth;
    settings.seed = options.seed;
    settings.aovs = options.aovs;
    settings.target_error = options.target_error;
    settings.resolution = options.resolution.x > 0 ? options.resolution : scene.film.resolution;
    settings.region =
        options.region.x >= 0 ? options.region : glm::ivec4(0, 0, settings.resolution.x, settings.resolution.y);
    const glm::ivec4 r = settings.region;
    if (r.x >= r.z || r.y >= r.w || r.z > settings.resolution.x || r.w > settings.resolution.y)
        throw UsageError("--region: found %d,%d,%d,%d, expected X0 < X1 <= %d and Y0 < Y1 <= %d", r.x, r.y, r.z, r.w,
                         settings.resolution.x, settings.resolution.y);
    return settings;
}

// Blocks are as long as the number of samples allows, at least 16 of them. Where only the time is known, the first
// sample tells how many fit; where only the error is known, 16 samples a block.
void choose_blocks(Outcome& outcome, const Options& options, const Scene& scene, const RayScene& rays,
                   const PlyScene* plies, RenderSettings settings)
{
    std::uint64_t planned = options.samples;
    if (options.time_s > 0.0) {
        settings.block_length = 64;
        outcome.renderer = std::make_unique<Renderer>(scene, rays, settings, plies);
        outcome.state = outcome.renderer->start();
        const auto start = Clock::now();
        outcome.renderer->add_samples(outcome.state, 1);
        const double fit = std::max(1.0, options.time_s / std::max(seconds_since(start), 1e-6));
        const std::uint64_t in_time = std::uint64_t(std::min(fit, double(sample_limit)));
        planned = planned > 0 ? std::min(planned, in_time) : in_time;
    }
    // Decisions of adaptive sampling are taken between pairs of blocks: short ones waste the least.
    if (options.target_error > 0.0) planned = std::min<std::uint64_t>(planned > 0 ? planned : 64, 64);
    settings.block_length = f32::cloth_block_length(std::uint32_t(planned));
    outcome.renderer = std::make_unique<Renderer>(scene, rays, settings, plies);
    if (outcome.state.samples == 0) outcome.state = outcome.renderer->start();
    if (outcome.state.samples == settings.block_length)
        for (PixelSums& sums : outcome.state.pixels) sums.finish_block(0);
}

void render(Outcome& outcome, const Options& options, const Scene& scene, const RayScene& rays, const PlyScene* plies,
            const std::string& checkpoint_path)
{
    RenderSettings settings = settings_of(options, scene);
    const std::string owner = checkpoint_owner(scene, settings) + (plies ? ", plies" : "");
    const auto start = Clock::now();
    std::optional<Checkpoint> checkpoint;
    if (options.resume) checkpoint = read_checkpoint(checkpoint_path, owner);
    if (checkpoint) {
        settings.block_length = checkpoint->block_length;
        outcome.renderer = std::make_unique<Renderer>(scene, rays, settings, plies);
        outcome.state = std::move(checkpoint->state);
        outcome.resumed_seconds = checkpoint->seconds;
        outcome.resumed_samples = outcome.state.samples;
        outcome.resumed_samples_mean =
            double(outcome.state.samples) - double(outcome.state.skipped) / double(outcome.state.pixels.size());
    } else {
        choose_blocks(outcome, options, scene, rays, plies, settings);
    }

    const Renderer& renderer = *outcome.renderer;
    RenderState& state = outcome.state;
    const std::uint64_t limit = options.samples > 0 ? options.samples : sample_limit;
    const double time_limit = options.time_s > 0.0 ? options.time_s : forever;
    const bool keeps_checkpoints = options.checkpoint_s > 0.0;
    const auto save = [&] {
        write_checkpoint(checkpoint_path, owner,
                         {renderer.settings().block_length, outcome.resumed_seconds + seconds_since(start), state});
    };
    Progress progress(options.quiet);
    std::uint64_t blocks_judged = 0;
    double per_sample = 0.0, saved = 0.0;
    outcome.error = renderer.error(state);
    for (;;) {
        const double seconds = seconds_since(start);
        if (state.samples >= limit) {
            outcome.stopped_by = "samples";
            break;
        }
        if (interrupted) {
            outcome.stopped_by = "signal";
            break;
        }
        if (seconds >= time_limit && state.samples > 0) {
            outcome.stopped_by = "time";
            break;
        }
        const std::uint64_t blocks = state.samples / renderer.settings().block_length;
        if (blocks != blocks_judged) {
            blocks_judged = blocks;
            outcome.error = renderer.error(state);
            if (renderer.finished(state)) {
                outcome.stopped_by = "error";
                break;
            }
        }
        double done = double(state.samples) / double(limit);
        if (time_limit < forever) done = std::max(done, seconds / time_limit);
        if (options.target_error > 0.0 && std::isfinite(outcome.error))
            done = std::max(done, options.target_error / outcome.error);
        progress.show(done, state.samples, outcome.error, seconds);

        // As many samples as take one pass, no further than the next block where an error is waited for.
        double room = per_sample > 0.0 ? std::min(pass_seconds, time_limit - seconds) / per_sample : 1.0;
        if (options.target_error > 0.0)
            room = std::min(
                room, double(renderer.settings().block_length - state.samples % renderer.settings().block_length));
        const std::uint64_t count =
            std::clamp<std::uint64_t>(std::uint64_t(std::max(room, 1.0)), 1, limit - state.samples);
        const auto pass_start = Clock::now();
        renderer.add_samples(state, std::uint32_t(count));
        per_sample = seconds_since(pass_start) / double(count);
        if (keeps_checkpoints && seconds_since(start) - saved >= options.checkpoint_s) {
            save();
            saved = seconds_since(start);
        }
    }
    progress.clear();
    outcome.error = renderer.error(state);
    outcome.seconds = outcome.resumed_seconds + seconds_since(start);
    if (keeps_checkpoints || (options.resume && interrupted)) save();
}

nlohmann::json skipped_json(const Scene& scene, const RayScene& rays, const Outcome& outcome)
{
    const bool environment = !scene.lights.empty() && scene.lights[0].kind == f32::cloth_light_environment;
    nlohmann::json skipped{
        {"shadow_rays_without_value", outcome.state.rays_saved},
        {"occlusion_filter", rays.needs().filtered_objects == 0},
        {"occlusion_filter_objects", rays.needs().objects - rays.needs().filtered_objects},
        {"environment_table", !environment || scene.environment.size.x == 1},
        {"black_lights", scene.black_lights},
        {"bounces", outcome.renderer->settings().integrator == Integrator::direct},
        {"samples", outcome.state.skipped},
    };
    nlohmann::json aovs = nlohmann::json::array();
    for (int k = 0; k < aov_count; ++k)
        if (!(outcome.renderer->settings().aovs >> k & 1u)) aovs.push_back(aov_rows[k].name);
    skipped["aovs"] = aovs;
    return skipped;
}

std::string number_text(double value)
{
    return format_text("%.9g", value);
}

int run(int argc, char** argv)
{
    bool done = false;
    const Options options = parse_options(argc, argv, done);
    if (done) return 0;
    const int threads = options.threads > 0 ? options.threads : tbb::this_task_arena::max_concurrency();
    tbb::global_control limit(tbb::global_control::max_allowed_parallelism, std::size_t(threads));
    tbb::task_arena arena(threads);

    Scene scene;
    arena.execute([&] { scene = load_scene(options.scene, options.overrides); });
    settings_of(options, scene); // a wrong --region is told before the tree is built
    if (!options.quiet)
        for (const std::string& warning : scene.warnings)
            std::fprintf(stderr, "%s: warning: %s\n", program, warning.c_str());

    const auto build_start = Clock::now();
    const RayScene rays(scene);
    const std::unique_ptr<PlyScene> plies =
        options.plies ? std::make_unique<PlyScene>(scene, ply_models(scene)) : nullptr;
    if (plies && !options.quiet)
        for (const std::string& warning : plies->warnings())
            std::fprintf(stderr, "%s: warning: %s\n", program, warning.c_str());
    const double build_seconds = seconds_since(build_start);

    std::signal(SIGINT, on_signal);
    std::signal(SIGTERM, on_signal);
    const std::string checkpoint_path = options.outputs.front() + ".checkpoint";
    Outcome outcome;
    arena.execute([&] { render(outcome, options, scene, rays, plies.get(), checkpoint_path); });

    const RenderState& state = outcome.state;
    const RenderSettings& settings = outcome.renderer->settings();
    const RenderResult result = outcome.renderer->result(state);
    ImageMetadata metadata = provenance(argc, argv);
    metadata["selvedge:scene"] = options.scene;
    metadata["selvedge:scene_hash"] = scene.hash;
    metadata["selvedge:seed"] = std::to_string(options.seed);
    metadata["selvedge:samples"] = std::to_string(state.samples);
    metadata["selvedge:seconds"] = number_text(outcome.seconds);
    metadata["selvedge:integrator"] = settings.integrator == Integrator::direct ? "direct" : "path";
    if (plies) metadata["selvedge:geometry"] = "plies";
    metadata["selvedge:block_length"] = std::to_string(settings.block_length);
    for (const std::string& path : options.outputs) write_result(path, result, scene.film.exposure, metadata);

    const std::uint64_t pixels = state.pixels.size();
    if (state.bad_samples > 0 && !options.quiet)
        std::fprintf(stderr, "%s: warning: %llu of %llu samples were not finite or negative and count as 0\n", program,
                     static_cast<unsigned long long>(state.bad_samples),
                     static_cast<unsigned long long>(state.samples * pixels));
    const double own_seconds = outcome.seconds - outcome.resumed_seconds;
    const double taken = double(state.samples * pixels - state.skipped), spp_mean = taken / double(pixels);
    const double rate = (spp_mean - outcome.resumed_samples_mean) * double(pixels) / std::max(own_seconds, 1e-9);
    if (options.json) {
        struct rusage usage {
        };
        getrusage(RUSAGE_SELF, &usage);
        nlohmann::json json{
            {"scene", options.scene},
            {"scene_hash", scene.hash},
            {"output", options.outputs},
            {"seconds",
             {{"load", scene.seconds_load},
              {"bake", scene.seconds_bake},
              {"build", build_seconds},
              {"render", outcome.seconds}}},
            {"resolution", {settings.resolution.x, settings.resolution.y}},
            {"region", {settings.region.x, settings.region.y, settings.region.z, settings.region.w}},
            {"integrator", metadata["selvedge:integrator"]},
            {"geometry", plies ? "plies" : "surface"},
            {"model", model_json(scene.model)},
            {"samples", state.samples * pixels - state.skipped},
            {"spp_mean", spp_mean},
            {"block_length", settings.block_length},
            {"samples_per_second", rate},
            {"rays", state.rays + state.shadow_rays},
            {"shadow_rays", state.shadow_rays},
            {"bad_samples", state.bad_samples},
            {"error_estimate", std::isfinite(outcome.error) ? nlohmann::json(outcome.error) : nlohmann::json()},
            {"stopped_by", outcome.stopped_by},
            {"resumed_samples", outcome.resumed_samples},
            {"threads", threads},
            {"triangles", plies ? plies->triangles() : rays.needs().triangles},
            {"instances", plies ? plies->instances() : 0},
            {"peak_rss_bytes", std::uint64_t(usage.ru_maxrss) * 1024},
            {"skipped", skipped_json(scene, rays, outcome)},
            {"warnings", scene.warnings},
        };
        std::printf("%s\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
    } else if (!options.quiet) {
        std::printf("%s: %d x %d, %llu spp in %.2f s, %.3g samples/s", options.outputs.front().c_str(), result.width,
                    result.height, static_cast<unsigned long long>(state.samples), outcome.seconds, rate);
        if (std::isfinite(outcome.error)) std::printf(", estimated relMSE %.3g", outcome.error);
        std::printf("\n");
    }
    return 0;
}

} // namespace

int main(int argc, char** argv)
{
    return selvedge::run_program(program, [&] { return run(argc, argv); });
}
