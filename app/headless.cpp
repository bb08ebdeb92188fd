// app/headless.cpp: the preview without a window: frames until an end is reached, then one picture and one report.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <deque>
#include <stdexcept>

#include <nlohmann/json.hpp>
#include <sys/resource.h>
#include <unistd.h>

#include "app/options.hpp"
#include "app/preview/context.hpp"
#include "app/preview/preview.hpp"
#include "app/preview/program_cache.hpp"
#include "app/preview/result.hpp"
#include "bake/error.hpp"
#include "bake/program.hpp"
#include "reference/denoise.hpp"

namespace selvedge
{
namespace
{

constexpr const char* program = "selvedge-lookdev";

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start)
{
    return std::chrono::duration<double>(Clock::now() - start).count();
}

// Lets the driver work one frame ahead, no further, and tells how long frames take.
class Pace
{
  public:
    // After a frame has been drawn: waits until the one before it is on the film.
    void frame_drawn()
    {
        fences.push_back(gl.FenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0));
        if (fences.size() > 1) wait_for_oldest();
    }
    void finish()
    {
        while (!fences.empty()) wait_for_oldest();
    }
    ~Pace()
    {
        for (const GLsync fence : fences) gl.DeleteSync(fence);
    }
    std::vector<double> milliseconds; // of every finished frame

  private:
    void wait_for_oldest()
    {
        // A driver may bound one wait; a frame may take longer.
        while (true) {
            const GLenum state = gl.ClientWaitSync(fences.front(), GL_SYNC_FLUSH_COMMANDS_BIT, 1'000'000'000);
            if (state == GL_WAIT_FAILED) check_gl("waiting for a frame");
            if (state != GL_TIMEOUT_EXPIRED) break;
        }
        gl.DeleteSync(fences.front());
        fences.pop_front();
        const Clock::time_point now = Clock::now();
        milliseconds.push_back(std::chrono::duration<double, std::milli>(now - last).count());
        last = now;
    }

    std::deque<GLsync> fences;
    Clock::time_point last = Clock::now();
};

double quantile(std::vector<double> values, double q)
{
    if (values.empty()) return 0;
    const auto rank = static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1) + 0.5);
    std::nth_element(values.begin(), values.begin() + rank, values.end());
    return values[static_cast<std::size_t>(rank)];
}

// What --spp asks for. The samples of a frame share the place in their pixel and cost less than those of other frames;
// where light has little noise, that of edges counts. So there are about as many frames as samples in one. A frame of
// two or three samples costs more than as many frames of one, which need not follow rays from layer to layer. They
// share the point of the lens as well, of which what is out of focus needs many.
void spread_samples(LookdevOptions& options, const CameraSpec& camera)
{
    const std::uint32_t samples_limit =
        camera.lens_radius > 0 ? 1 : 32; // of 32 a frame's own cost is small beside theirs
    std::uint32_t samples = 1;
    while (samples < samples_limit && 4 * samples * samples <= options.spp) samples *= 2;
    if (samples < 4) samples = 1;
    options.footprint_samples = static_cast<int>(samples);
    options.frames = (options.spp + samples - 1) / samples;
}

// Blocks are as long as the number of frames allows, at least 16 of them; where the error ends the work,
// adaptive_planned() does.
//   in_time  frames that the time allows; 0: nobody knows
std::uint32_t planned_frames(const LookdevOptions& options, std::uint32_t in_time)
{
    const std::uint32_t frames =
        options.frames > 0 && in_time > 0 ? std::min(options.frames, in_time) : std::max(options.frames, in_time);
    if (options.target_error > 0) return adaptive_planned(frames);
    // Places in the pixel are few where samples share them, and their stratification makes more of them: four in a
    // block if there are four blocks.
    if (options.spp > 0 && options.footprint_samples > 1) return std::max(frames, std::min(4 * frames, 64u));
    return frames;
}

// Draws frames until one of the ends is reached, one at least. Returns which.
const char* draw_frames(Preview& preview, const LookdevOptions& options, Pace& pace, bool progress)
{
    const Clock::time_point start = Clock::now();
    double last_line = 0;
    const char* stopped_by = "signal";
    do {
        preview.draw_frame();
        pace.frame_drawn();
        if (context_lost()) throw std::runtime_error("the GL driver has lost the context; no picture is written");
        const std::uint32_t frames = preview.frames();
        const double seconds = seconds_since(start);
        // Only now is it known how many frames a time is worth. The first one has compiled the shaders and does not
        // count.
        if (options.time_s > 0 && frames == 3) {
            const double fit = std::clamp(options.time_s * 1e3 / std::max(pace.milliseconds.back(), 1e-3), 1.0, 1e7);
            const auto in_time = static_cast<std::uint32_t>(fit);
            preview.plan(planned_frames(options, in_time));
        }
        if (progress && seconds - last_line > 0.25) {
            std::fprintf(stderr, "\r%u frames, %.1f s", frames, seconds);
            last_line = seconds;
        }
        if (options.frames > 0 && frames >= options.frames) {
            stopped_by = "samples";
            break;
        }
        if (options.time_s > 0 && seconds >= options.time_s) {
            stopped_by = "time";
            break;
        }
        if (preview.finished()) {
            stopped_by = "error";
            break;
        }
    } while (!interrupted());
    pace.finish();
    if (progress) std::fprintf(stderr, "\r\33[K");
    return stopped_by;
}

} // namespace

int run_headless(LookdevOptions options)
{
    Scene scene = load_scene(options.scene, options.overrides);
    if (options.resolution) scene.film.resolution = *options.resolution;
    if (options.spp > 0) spread_samples(options, scene.camera);
    if (!options.quiet)
        for (const std::string& warning : scene.warnings)
            std::fprintf(stderr, "%s: warning: %s\n", program, warning.c_str());

    const Clock::time_point build_start = Clock::now();
    const auto context = Context::create(options.backend);
    PreviewOptions preview_options = options.for_preview();
    preview_options.footprint_samples = options.footprint_samples;
    preview_options.max_depth = options.paths ? options.max_depth : 1;
    preview_options.planned_size = scene.film.resolution;
    preview_options.target_error = options.target_error;
    preview_options.reproject = false; // nothing moves
    preview_options.planned = 1;
    end_by_itself_when_interrupted();
    // The first frame compiles, in the driver as well, and the second one what differs in the state that the first
    // leaves (on llvmpipe 0.4 s): two of few pixels, which are not looked at. Drivers compile for sides that are powers
    // of two by themselves.
    const auto few = [](int side) { return (side & (side - 1)) == 0 ? 1 : 3; };
    const glm::ivec2 size = scene.film.resolution;
    Preview preview(scene, context->info, {few(size.x), few(size.y)}, preview_options);
    for (int k = 0; k < 2; ++k) preview.draw_frame();
    preview.resize(size);
    preview.restart();
    preview.plan(planned_frames(options, 0)); // where only the time is known, draw_frames() finds out
    gl.Finish();
    const double seconds_build = seconds_since(build_start);

    const Clock::time_point start = Clock::now();
    Pace pace;
    const char* stopped_by = draw_frames(preview, options, pace, !options.quiet && isatty(STDERR_FILENO) == 1);
    check_gl("drawing");
    const double seconds_render = seconds_since(start);

    RenderResult result = result_of(preview.read());
    // Two blocks of a half at least: below, the variances are 0 and say nothing.
    const bool tiled = preview.tile_count() > 0;
    const bool estimated = preview.frames() / preview.block_length() >= (tiled ? 4 : 2);
    const nlohmann::json error = estimated ? nlohmann::json(error_estimate(result)) : nlohmann::json();
    const Clock::time_point denoise_start = Clock::now();
    const bool cleaned = options.denoise && denoise(result);
    const double seconds_denoise = seconds_since(denoise_start);
    if (options.denoise && !cleaned && !options.quiet)
        std::fprintf(stderr, "%s: warning: %s\n", program, noise_unknown);
    const char* integrator = options.paths ? "path" : "direct";
    ImageMetadata metadata = options.provenance;
    metadata["selvedge:scene"] = options.scene;
    metadata["selvedge:scene_hash"] = scene.hash;
    metadata["selvedge:seed"] = std::to_string(options.seed);
    metadata["selvedge:samples"] =
        std::to_string(preview.frames() * static_cast<std::uint32_t>(options.footprint_samples));
    metadata["selvedge:seconds"] = format_text("%.9g", seconds_render);
    metadata["selvedge:integrator"] = integrator;
    metadata["selvedge:block_length"] = std::to_string(preview.block_length());
    metadata["selvedge:gl"] = context->info.renderer + ", " + context->info.version;
    if (cleaned) metadata["selvedge:denoised"] = denoised_by;
    for (const std::string& path : options.outputs) write_result(path, result, scene.film.exposure, metadata);

    const auto pixels = static_cast<std::uint64_t>(result.width) * static_cast<std::uint64_t>(result.height);
    const double median = quantile(pace.milliseconds, 0.5);
    if (options.json) {
        rusage usage{};
        getrusage(RUSAGE_SELF, &usage);
        nlohmann::json report = {
            {"scene", options.scene},
            {"scene_hash", scene.hash},
            {"output", options.outputs},
            {"seconds",
             {{"load", scene.seconds_load},
              {"bake", scene.seconds_bake},
              {"build", seconds_build},
              {"render", seconds_render}}},
            {"resolution", {result.width, result.height}},
            {"integrator", integrator},
            {"model", model_json(scene.model)},
            {"samples", preview.samples()},
            {"spp_mean", static_cast<double>(preview.samples()) / static_cast<double>(pixels)},
            {"block_length", preview.block_length()},
            {"samples_per_second", static_cast<double>(preview.samples()) / std::max(seconds_render, 1e-9)},
            {"rays", nullptr}, // nobody counts them in a shader
            {"error_estimate", error},
            {"denoised", cleaned},
            {"stopped_by", stopped_by},
            {"peak_rss_bytes", static_cast<std::uint64_t>(usage.ru_maxrss) * 1024},
            {"buffer_bytes", preview.buffer_bytes()},
            {"skipped", preview.skipped()},
            {"programs", {{"compiled", program_counts().compiled}, {"cached", program_counts().cached}}},
            {"gl",
             {{"renderer", context->info.renderer}, {"version", context->info.version}, {"backend", context->backend}}},
            {"frames", preview.frames()},
            {"tiles", tiled ? nlohmann::json{{"side", tile_side},
                                             {"count", preview.tile_count()},
                                             {"stopped", preview.tiles_done()}}
                            : nlohmann::json()},
            {"footprint_samples", options.footprint_samples},
            {"milliseconds_per_frame", {{"median", median}, {"p95", quantile(pace.milliseconds, 0.95)}}},
            {"features", preview.features()},
            {"passes", preview.pass_names()},
            {"warnings", scene.warnings},
        };
        if (options.denoise) report["seconds"]["denoise"] = seconds_denoise;
        std::printf("%s\n", report.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
    } else if (!options.quiet) {
        std::printf("%s: %d x %d, %u frames in %.2f s, %.3g ms a frame (%s, %s)\n", options.outputs.front().c_str(),
                    result.width, result.height, preview.frames(), seconds_render, median, context->backend,
                    context->info.renderer.c_str());
    }
    return 0;
}

} // namespace selvedge
