// selvedge-render: renders one scene with the reference integrators. Exit 0 done, 1 input or I/O failed, 2 wrong usage.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <limits>
#include <memory>

#include <sys/resource.h>
#include <unistd.h>

#include <nlohmann/json.hpp>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include "bake/error.hpp"
#include "bake/image.hpp"
#include "bake/program.hpp"
#include "reference/checkpoint.hpp"
#include "reference/denoise.hpp"
#include "reference/film.hpp"
#include "reference/integrator.hpp"
#include "reference/model.hpp"
#include "reference/plies.hpp"
#include "reference/rays.hpp"
#include "reference/render_options.hpp"
#include "reference/scene.hpp"

namespace
{

using namespace selvedge;
namespace f32 = cloth::f32;
using Clock = std::chrono::steady_clock;

constexpr double pass_seconds = 0.25; // a pass is as many samples as fit: SIGINT and --time wait for one
constexpr double forever = std::numeric_limits<double>::infinity();

// ---- progress ------------------------------------------------------------------------------------------------------

double seconds_since(Clock::time_point start)
{
    return std::chrono::duration<double>(Clock::now() - start).count();
}

// "45 s", "12 min 5 s", "3 h 20 min"
std::string duration_text(double seconds)
{
    const auto whole = static_cast<long long>(std::min(seconds, 1e12) + 0.5);
    if (whole < 60) return format_text("%lld s", whole);
    if (whole < 3600) return format_text("%lld min %lld s", whole / 60, whole % 60);
    return format_text("%lld h %lld min", whole / 3600, whole / 60 % 60);
}

// One line that overwrites itself, on a terminal only.
class Progress
{
  public:
    // `label` goes before the bar; `pictures_left` come after this one, and are taken to need as long.
    Progress(bool quiet, std::string label, int pictures_left)
        : shown_(!quiet && isatty(STDERR_FILENO) == 1), label_(std::move(label)), pictures_left_(pictures_left)
    {
    }
    ~Progress() { clear(); }
    void show(double done, std::uint64_t samples, double error, double seconds)
    {
        if (!shown_) return;
        constexpr int width = 30;
        const int full = int(std::clamp(done, 0.0, 1.0) * width);
        std::string bar(std::size_t(full), '=');
        bar.resize(width, ' ');
        std::string line =
            format_text("\r%s[%s] %3d %%  %llu spp", label_.c_str(), bar.c_str(),
                        int(100.0 * std::clamp(done, 0.0, 1.0)), static_cast<unsigned long long>(samples));
        if (std::isfinite(error)) line += format_text("  error %.2e", error);
        if (done > 0.0 && done < 1.0)
            line += "  " + duration_text(seconds / done * (1.0 - done + double(pictures_left_))) + " left";
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
    std::string label_;
    int pictures_left_;
};

// ---- the job
// ---------------------------------------------------------------------------------------------------------------

// One picture: the files, the scene's settings, and what the sequence does to the scene.
struct Job {
    std::vector<std::string> outputs;
    Overrides overrides;
    double turn_degrees = 0.0;
    std::string label;     // "picture 3 of 36  " before the progress bar
    int pictures_left = 0; // after this one
};

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

RenderSettings settings_of(const RenderOptions& options, const Scene& scene)
{
    RenderSettings settings;
    settings.integrator = options.integrator;
    settings.max_depth = options.max_depth;
    settings.mis = options.mis;
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

// Whose samples they are: those of one geometry do not go on with those of the other.
std::string owner_text(const RenderOptions& options, const Scene& scene, const RenderSettings& settings)
{
    return checkpoint_owner(scene, settings) + (options.plies ? ", plies" : "");
}

// Blocks are as long as the number of samples allows, at least 16 of them. Where only the time is known, the first
// sample tells how many fit; where the error ends the work, adaptive_planned() does.
void choose_blocks(Outcome& outcome, const RenderOptions& options, const Scene& scene, const RayScene& rays,
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
    if (options.target_error > 0.0) planned = adaptive_planned(planned);
    settings.block_length = f32::cloth_block_length(std::uint32_t(planned));
    outcome.renderer = std::make_unique<Renderer>(scene, rays, settings, plies);
    if (outcome.state.samples == 0) outcome.state = outcome.renderer->start();
    if (outcome.state.samples == settings.block_length)
        for (PixelSums& sums : outcome.state.pixels) sums.finish_block(0);
}

void render(Outcome& outcome, const RenderOptions& options, const Job& job, const Scene& scene, const RayScene& rays,
            const PlyScene* plies, const std::string& checkpoint_path)
{
    RenderSettings settings = settings_of(options, scene);
    const std::string owner = owner_text(options, scene, settings);
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
    Progress progress(options.quiet, job.label, job.pictures_left);
    std::uint64_t blocks_judged = 0;
    double per_sample = 0.0, saved = 0.0;
    outcome.error = renderer.error(state);
    for (;;) {
        const double seconds = seconds_since(start);
        if (state.samples >= limit) {
            outcome.stopped_by = "samples";
            break;
        }
        if (interrupted()) {
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
        const double pass = keeps_checkpoints ? std::min(pass_seconds, options.checkpoint_s) : pass_seconds;
        double room = per_sample > 0.0 ? std::min(pass, time_limit - seconds) / per_sample : 1.0;
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
    // A sequence is gone on with by --resume whether or not checkpoints were asked for: it is long.
    if (keeps_checkpoints || (interrupted() && (options.resume || options.sequence.any()))) save();
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

// What a picture holds when it is complete: in its header, so that --resume knows it again.
std::string work_text(const RenderOptions& options, const Scene& scene, const RenderSettings& settings)
{
    return owner_text(options, scene, settings) +
           format_text(", %llu spp, %.9g s, error %.9g", static_cast<unsigned long long>(options.samples),
                       options.time_s, options.target_error) +
           (options.denoise ? ", denoised" : "");
}

bool is_complete(const std::vector<std::string>& outputs, const std::string& work)
{
    for (const std::string& path : outputs) {
        std::error_code code;
        if (!std::filesystem::exists(path, code)) return false;
        const ImageMetadata found = read_metadata(path);
        const auto text = found.find("selvedge:work");
        if (text == found.end() || text->second != work) return false;
    }
    return true;
}

// Loads, renders and writes one picture; the report for --json, null where the picture was complete already or a signal
// came before rendering began.
nlohmann::json render_picture(const RenderOptions& options, const Job& job, tbb::task_arena& arena, int threads,
                              const ImageMetadata& provenance)
{
    Scene scene;
    arena.execute([&] { scene = load_scene(options.scene, job.overrides); });
    if (job.turn_degrees != 0.0) turn_scene(scene, options.sequence.turned, job.turn_degrees);
    // A wrong --region is told before the tree is built.
    const std::string work = work_text(options, scene, settings_of(options, scene));
    if (options.sequence.any() && options.resume && is_complete(job.outputs, work)) return {};
    if (!options.quiet)
        for (const std::string& warning : scene.warnings)
            std::fprintf(stderr, "%s: warning: %s\n", render_program, warning.c_str());

    const auto build_start = Clock::now();
    const RayScene rays(scene);
    const std::unique_ptr<PlyScene> plies =
        options.plies ? std::make_unique<PlyScene>(scene, ply_models(scene)) : nullptr;
    if (plies && !options.quiet)
        for (const std::string& warning : plies->warnings())
            std::fprintf(stderr, "%s: warning: %s\n", render_program, warning.c_str());
    const double build_seconds = seconds_since(build_start);

    if (interrupted()) return {};
    end_by_itself_when_interrupted();
    const std::string checkpoint_path = job.outputs.front() + ".checkpoint";
    Outcome outcome;
    arena.execute([&] { render(outcome, options, job, scene, rays, plies.get(), checkpoint_path); });
    const bool complete = std::strcmp(outcome.stopped_by, "signal") != 0;

    const RenderState& state = outcome.state;
    const RenderSettings& settings = outcome.renderer->settings();
    RenderResult result = outcome.renderer->result(state);
    const auto denoise_start = Clock::now();
    bool cleaned = false;
    if (options.denoise) arena.execute([&] { cleaned = denoise(result); });
    const double denoise_seconds = seconds_since(denoise_start);
    if (options.denoise && !cleaned && !options.quiet)
        std::fprintf(stderr, "%s: warning: %s\n", render_program, noise_unknown);
    ImageMetadata metadata = provenance;
    metadata["selvedge:scene"] = options.scene;
    metadata["selvedge:scene_hash"] = scene.hash;
    metadata["selvedge:seed"] = std::to_string(options.seed);
    metadata["selvedge:samples"] = std::to_string(state.samples);
    metadata["selvedge:seconds"] = number_text(outcome.seconds);
    metadata["selvedge:integrator"] = settings.integrator == Integrator::direct ? "direct" : "path";
    if (plies) metadata["selvedge:geometry"] = "plies";
    metadata["selvedge:block_length"] = std::to_string(settings.block_length);
    if (complete) metadata["selvedge:work"] = work;
    if (cleaned) metadata["selvedge:denoised"] = denoised_by;
    for (const std::string& path : job.outputs) write_result(path, result, scene.film.exposure, metadata);
    // Complete pictures of a sequence are known by their headers; their checkpoints would fill the disk.
    std::error_code ignored;
    if (complete && options.sequence.any()) std::filesystem::remove(checkpoint_path, ignored);

    const std::uint64_t pixels = state.pixels.size();
    if (state.bad_samples > 0 && !options.quiet)
        std::fprintf(stderr, "%s: warning: %llu of %llu samples were not finite or negative and count as 0\n",
                     render_program, static_cast<unsigned long long>(state.bad_samples),
                     static_cast<unsigned long long>(state.samples * pixels));
    const double own_seconds = outcome.seconds - outcome.resumed_seconds;
    const double taken = double(state.samples * pixels - state.skipped), spp_mean = taken / double(pixels);
    const double rate = (spp_mean - outcome.resumed_samples_mean) * double(pixels) / std::max(own_seconds, 1e-9);
    if (!options.json && !options.quiet) {
        std::printf("%s: %d x %d, %llu spp in %.2f s, %.3g samples/s", job.outputs.front().c_str(), result.width,
                    result.height, static_cast<unsigned long long>(state.samples), outcome.seconds, rate);
        if (std::isfinite(outcome.error)) std::printf(", estimated relMSE %.3g", outcome.error);
        std::printf("\n");
    }
    struct rusage usage {
    };
    getrusage(RUSAGE_SELF, &usage);
    nlohmann::json report = {
        {"scene", options.scene},
        {"scene_hash", scene.hash},
        {"output", job.outputs},
        {"seconds",
         {{"load", scene.seconds_load},
          {"bake", scene.seconds_bake},
          {"build", build_seconds},
          {"render", outcome.seconds}}},
        {"resolution", {settings.resolution.x, settings.resolution.y}},
        {"region", {settings.region.x, settings.region.y, settings.region.z, settings.region.w}},
        {"integrator", metadata["selvedge:integrator"]},
        {"mis", settings.mis},
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
        {"denoised", cleaned},
        {"stopped_by", outcome.stopped_by},
        {"resumed_samples", outcome.resumed_samples},
        {"threads", threads},
        {"triangles", plies ? plies->triangles() : rays.needs().triangles},
        {"instances", plies ? plies->instances() : 0},
        {"peak_rss_bytes", std::uint64_t(usage.ru_maxrss) * 1024},
        {"skipped", skipped_json(scene, rays, outcome)},
        {"warnings", scene.warnings},
    };
    if (options.denoise) report["seconds"]["denoise"] = denoise_seconds;
    return report;
}

// Pictures of a sequence one after the other, or the one picture.
nlohmann::json render_all(const RenderOptions& options, tbb::task_arena& arena, int threads,
                          const ImageMetadata& provenance)
{
    const Sequence& sequence = options.sequence;
    if (!sequence.any())
        return render_picture(options, {options.outputs, options.overrides, 0.0, "", 0}, arena, threads, provenance);
    nlohmann::json pictures = nlohmann::json::array();
    int complete = 0;
    for (int frame = sequence.first; frame <= sequence.last && !interrupted(); ++frame) {
        Job job;
        for (const std::string& path : options.outputs) job.outputs.push_back(frame_path(path, frame));
        job.overrides = frame_overrides(options.overrides, frame);
        if (sequence.turntable > 0) job.turn_degrees = 360.0 * frame / sequence.turntable;
        job.label = format_text("picture %d of %d  ", frame - sequence.first + 1, sequence.last - sequence.first + 1);
        job.pictures_left = sequence.last - frame;
        const nlohmann::json report = render_picture(options, job, arena, threads, provenance);
        if (!report.is_null())
            pictures.push_back(report);
        else if (!interrupted())
            ++complete;
    }
    return {{"pictures", pictures}, {"complete_before", complete}, {"turntable", sequence.turntable}};
}

int run(int argc, char** argv)
{
    bool done = false;
    const RenderOptions options = parse_render_options(argc, argv, done);
    if (done) return 0;
    const int threads = options.threads > 0 ? options.threads : tbb::this_task_arena::max_concurrency();
    tbb::global_control limit(tbb::global_control::max_allowed_parallelism, std::size_t(threads));
    tbb::task_arena arena(threads);
    const nlohmann::json report = render_all(options, arena, threads, provenance(argc, argv));
    if (options.json)
        std::printf("%s\n", report.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
    return 0;
}

} // namespace

int main(int argc, char** argv)
{
    return selvedge::run_program(render_program, [&] { return run(argc, argv); });
}
