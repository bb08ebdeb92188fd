// app/preview/preview.cpp: frames, blocks, restarts.
#include "app/preview/preview.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "app/preview/result.hpp"
#include "bake/error.hpp"
#include "reference/denoise.hpp"

namespace selvedge
{

using namespace cloth::f32;

// Blocks of each half before the first decision. More than the reference takes: all pixels of a frame share its jitter,
// so that a tile's spread is less certain. With as many as there, the error of the demo scene came out 7 % above the
// target; with twice as many, 4 % below.
static constexpr std::uint32_t pilot_blocks = 2 * adaptive_pilot;

// Frames after which it pays to find out what blocks of pixels see: it takes as long as two to nine frames save (demo
// 256 x 256 nine, curtain_fabrics 512 x 512 three, cylinder_satin 256 x 256 two; llvmpipe, 2 cores).
static constexpr std::uint32_t settling_frames = 8;

// Frames from which the filter knows the noise well enough to gain by it.
static constexpr std::uint32_t least_frames = 4;

Preview::Preview(const Scene& from, const GlInfo& gl_info, glm::ivec2 resolution, const PreviewOptions& wanted)
    : scene(from), info(gl_info), options(wanted), camera(from.camera), buffers(gl_info), passes(gl_info)
{
    shape = blocking_shape(scene);
    targets.resize(resolution, options.target_error > 0, options.knows_spread, info);
    find_needs();
    buffers.upload(scene, needs);
    update_near_plane();
    restart();
}

void Preview::find_needs()
{
    needs = Needs::of(scene, shape, camera, options.footprint_samples, options.max_depth, options.kept);
    needs.camera_rays = finds_by_rays();
    // Where a processor has a thread for each pixel, those that see nothing end by themselves; where samples share a
    // ray, what it walks is little beside them.
    if (needs.camera_rays ? needs.several_points : computes()) needs.seen = needs.skipped["unseen"] = false;
    passes.choose(needs, options.target_error > 0, options.knows_spread, computes());
}

// Software GL prepares triangles by one core and looks gauze up that something nearer hides. Both cost the same at 2
// pixels a triangle of layers, at 5 of demo and curtain_fabrics, at more than 100 of cylinder_satin (128 x 128 to
// 1448 x 1448, llvmpipe, 2 cores).
bool Preview::finds_by_rays() const
{
    if (options.finding != Finding::automatic) return options.finding == Finding::rays;
    if (!info.software || !needs.traces_rays()) return false;
    const glm::ivec2 size = options.planned_size.x > 0 ? options.planned_size : targets.size();
    std::size_t triangles = 0;
    for (const SceneObject& object : scene.objects) triangles += object.mesh.triangles.size();
    return static_cast<std::size_t>(size.x) * static_cast<std::size_t>(size.y) < 4 * triangles;
}

bool Preview::computes() const
{
    if (options.shading == Shading::compute && !info.compute)
        throw std::runtime_error(
            format_text("compute shaders need GL 4.3; found %s (%s)", info.version.c_str(), info.renderer.c_str()));
    return options.shading == Shading::automatic ? info.compute && !info.software : options.shading == Shading::compute;
}

void Preview::set_camera(const CameraSpec& wanted)
{
    remember();
    camera = wanted;
    const bool traced = needs.traces_rays();
    find_needs();
    if (needs.traces_rays() != traced) buffers.upload_bvh(scene, needs);
    update_near_plane();
    begin_again();
}

void Preview::set_options(const PreviewOptions& wanted)
{
    options = wanted;
    find_needs();
    buffers.upload(scene, needs);
    targets.resize(targets.size(), options.target_error > 0, options.knows_spread, info);
    restart();
}

void Preview::resize(glm::ivec2 resolution)
{
    remember();
    targets.resize(resolution, options.target_error > 0, options.knows_spread, info);
    find_needs();
    has_carried = false;
    frame_count = block_count = denoised_frames = 0;
    update_near_plane();
    begin_again();
}

void Preview::lights_changed()
{
    buffers.upload_lights(scene);
    find_needs();
    restart();
}

void Preview::yarns_changed()
{
    buffers.upload_yarns(scene);
    find_needs();
    restart();
}

void Preview::scene_changed()
{
    shape = blocking_shape(scene);
    find_needs();
    buffers.upload(scene, needs);
    update_near_plane();
    restart();
}

void Preview::model_changed()
{
    find_needs();
    buffers.upload_fabrics(scene, needs); // which objects rays may pass through is the model's matter too
    restart();
}

void Preview::restart()
{
    has_past = false;
    view_count = 0;
    begin_again();
}

void Preview::remember()
{
    // Where the present view has no frame yet, the past is still the one before.
    if (stale) return;
    ++view_count;
    if (!options.reproject) return;
    passes.remember(targets, buffers, shown_weights());
    past = make_camera(camera, targets.size());
    has_past = true;
}

ShownWeights Preview::shown_weights() const
{
    const float drawn = static_cast<float>(std::max(frame_count, 1u));
    const float left = 1 - drawn / static_cast<float>(carry_frames);
    const auto share = [&](int half) { return static_cast<float>(blocks_of(half) * length) / drawn; };
    return {1 / drawn, share(0), share(1), drawn, has_carried ? std::max(left, 0.0f) : 0};
}

// Even and odd ones where there are tiles, else half 0 has them all.
std::uint32_t Preview::blocks_of(int half) const
{
    if (options.target_error > 0) return (block_count + 1 - static_cast<std::uint32_t>(half)) / 2;
    return half == 0 ? block_count : 0;
}

void Preview::restart_tiles()
{
    tiles.clear();
    if (options.target_error <= 0) return;
    const glm::ivec2 count = targets.tiles();
    tiles.resize(static_cast<std::size_t>(count.x) * static_cast<std::size_t>(count.y));
    pilot[0] = pilot[1] = 0;
    passes.set_tiles(targets.size(), std::vector<bool>(tiles.size(), true));
}

void Preview::judge()
{
    const std::uint32_t blocks = block_count / 2;
    std::vector<glm::vec4> noise(tiles.size());
    passes.judge(targets);
    targets.read_tiles(&noise[0].x);
    // The shader adds squared deviations of block means up; a sample's variance is `length` times that of a block.
    const double of_sample = length / (blocks - 1.0);
    std::vector<TileSpread> spreads(tiles.size());
    for (std::size_t k = 0; k < tiles.size(); ++k) {
        spreads[k].count = static_cast<double>(noise[k].z);
        for (int half = 0; half < 2; ++half)
            spreads[k].variance[half] = of_sample * static_cast<double>(noise[k][half]) / spreads[k].count;
    }
    const std::vector<TileState> before = tiles;
    const TileStops stops = judge_tiles(tiles, spreads, pilot, frame_count, blocks, options.target_error);
    for (int half = 0; half < 2; ++half) {
        const std::vector<bool>& ends = stops.half[half];
        if (std::find(ends.begin(), ends.end(), true) == ends.end()) continue;
        passes.set_tiles(targets.size(), ends);
        passes.keep(targets, half, blocks);
    }
    std::vector<bool> drawn(tiles.size());
    for (std::size_t k = 0; k < tiles.size(); ++k) {
        drawn[k] = !tiles[k].done();
        if (!drawn[k] && !before[k].done()) tiles[k].samples = frame_count;
    }
    if (!all_done(tiles)) passes.set_tiles(targets.size(), drawn);
}

std::size_t Preview::tiles_done() const
{
    if (stale) return 0;
    return static_cast<std::size_t>(
        std::count_if(tiles.begin(), tiles.end(), [](const TileState& tile) { return tile.done(); }));
}

std::uint64_t Preview::samples() const
{
    const glm::ivec2 size = targets.size(), count = targets.tiles();
    const auto points = static_cast<std::uint64_t>(options.footprint_samples);
    if (stale || tiles.empty())
        return points * frames() * static_cast<std::uint64_t>(size.x) * static_cast<std::uint64_t>(size.y);
    std::uint64_t sum = 0;
    for (int y = 0; y < count.y; ++y)
        for (int x = 0; x < count.x; ++x) {
            const glm::ivec2 side = glm::min(size - glm::ivec2(x, y) * tile_side, glm::ivec2(tile_side));
            sum += static_cast<std::uint64_t>(side.x * side.y) *
                   samples_of(tiles[static_cast<std::size_t>(y * count.x + x)]);
        }
    return points * sum;
}

void Preview::begin_again()
{
    stale = true;
    length = cloth_block_length(options.planned);
}

void Preview::plan(std::uint32_t planned)
{
    if (!stale && block_count > 0) return;
    options.planned = planned;
    length = cloth_block_length(planned);
    // What is drawn already is the beginning of the first block.
    while (length <= frames()) length *= 2;
}

// As far away as it may be without cutting anything off, because reversed depth loses digits where near / w is small
// beside what a triangle has in front of the camera.
void Preview::update_near_plane()
{
    const ClothCamera eye = make_camera(camera, targets.size());
    const ClothLens lens = lens_of(camera);
    // The longest direction of a ray, and what a point of the lens is nearer than the middle.
    const float corner =
        std::sqrt(1.0f + glm::dot(eye.right, eye.right) + glm::dot(eye.up, eye.up)) + lens.radius / lens.distance;
    const float nearest = SceneBuffers::nearest_distance(scene, camera.position) - lens.radius;
    near_plane = std::clamp(0.5f * nearest / corner, 1e-6f, 1e6f);
}

bool Preview::draw_frame()
{
    if (!passes.prepare(buffers, options.waits)) return false;
    if (finished()) return true;
    if (stale) {
        targets.clear_accumulation();
        restart_tiles();
        has_carried = false;
        frame_count = block_count = denoised_frames = 0;
        stale = false;
    }
    const ClothCamera centre = make_camera(camera, targets.size());
    const std::uint32_t view_seed = view_count == 0 ? options.seed : cloth_hash_combine(options.seed, ~view_count);
    const std::uint32_t block_seed = cloth_hash_combine(view_seed, block_count);
    const std::uint32_t index = frame_count % length;
    const auto points = static_cast<std::uint32_t>(options.footprint_samples);
    const glm::vec2 offset = cloth_filter_offset(scene.film.filter, cloth_random(block_seed, index, cloth_dim_pixel));
    // One point of the lens a frame.
    const ClothCamera eye = cloth_lens_camera(centre, lens_of(camera), cloth_random(block_seed, index, cloth_dim_lens));
    const glm::vec3 shear = eye.forward - centre.forward;
    block::Frame frame;
    frame.camera_position = glm::vec4(eye.position, 0);
    frame.camera_forward = glm::vec4(centre.forward, near_plane);
    frame.lens = glm::vec4(glm::dot(shear, eye.right) / glm::dot(eye.right, eye.right),
                           glm::dot(shear, eye.up) / glm::dot(eye.up, eye.up), 0, 0);
    frame.camera_right = glm::vec4(eye.right, 1 / glm::dot(eye.right, eye.right));
    frame.camera_up = glm::vec4(eye.up, 1 / glm::dot(eye.up, eye.up));
    frame.film = glm::vec4(eye.resolution, offset);
    frame.random = glm::uvec4(block_seed, index * points, points, static_cast<std::uint32_t>(options.max_depth));
    frame.depth = glm::ivec4(info.clip_control ? 1 : 0, 0, 0, 0);
    frame.lights = glm::ivec4(static_cast<int>(scene.lights.size()), scene.environment.size, buffers.node_count);
    const ClothSettings& model = needs.model;
    frame.model = glm::ivec4(model.bsdf, model.weight, model.visibility, model.slab);
    frame.ingredients = glm::ivec4(model.unscattered, model.interreflection, model.twist_noise, 0);
    frame.past_position = glm::vec4(past.position, 0);
    frame.past_forward = glm::vec4(past.forward, 0);
    frame.past_right = glm::vec4(past.right, 1 / std::max(glm::dot(past.right, past.right), 1e-30f));
    frame.past_up = glm::vec4(past.up, 1 / std::max(glm::dot(past.up, past.up), 1e-30f));
    passes.set_frame(frame);
    // While the camera moves no view has a second frame.
    if (needs.traces_rays() && (frame_count > 0 || options.planned > 0))
        buffers.order_bvh(camera.position, !info.software);
    if (needs.camera_rays && needs.seen) {
        if (frame_count == 0) passes.set_blocks(targets.size(), buffers.upload_blocks(targets.size()));
        if (frame_count == settling_frames)
            passes.set_blocks(targets.size(), buffers.upload_blocks(centre, lens_of(camera), scene.film.filter));
    }
    buffers.bind_textures();
    if (!needs.camera_rays) passes.visibility(targets, buffers);
    targets.bind_textures();
    passes.shade(targets, buffers);
    if (has_past && frame_count == 0) {
        passes.carry(targets, buffers);
        has_carried = true;
    }
    ++frame_count;
    if (index + 1 == length) {
        const int half = tiles.empty() ? 0 : static_cast<int>(block_count % 2);
        ++block_count;
        passes.merge(targets, half, length, blocks_of(half));
        if (!tiles.empty() && half == 1 && block_count / 2 >= pilot_blocks) judge();
    }
    return true;
}

void Preview::present(glm::ivec2 corner, glm::ivec2 size, float exposure, bool denoised)
{
    denoised = denoised && !finished();
    if (denoised && !stale) refresh_denoised();
    passes.present(targets, corner, size, shown_weights(), exposure, denoised && denoised_frames > 0);
}

// Makes the filtered picture anew where there are a quarter more samples, as long as that takes no more than a tenth of
// the time.
void Preview::refresh_denoised()
{
    using Clock = std::chrono::steady_clock;
    const std::uint32_t first = has_carried ? carry_frames : least_frames; // earlier views know more until then
    if (frame_count < std::max(first, denoised_frames + (denoised_frames + 3) / 4)) return;
    const Clock::time_point start = Clock::now();
    if (denoised_frames > 0 && std::chrono::duration<double>(start - denoised_at).count() < 9 * denoise_seconds) return;
    GLint framebuffer = 0; // that reading unbinds
    gl.GetIntegerv(GL_DRAW_FRAMEBUFFER_BINDING, &framebuffer);
    RenderResult result = result_of(read());
    gl.BindFramebuffer(GL_FRAMEBUFFER, static_cast<GLuint>(framebuffer));
    if (!denoise(result)) return;
    targets.show(&result.mean[0].x);
    denoised_frames = frame_count;
    denoised_at = Clock::now();
    denoise_seconds = std::chrono::duration<double>(denoised_at - start).count();
}

PreviewImage Preview::read() const
{
    PreviewImage image;
    image.size = targets.size();
    image.frames = frame_count; // of the picture that is on show
    image.blocks = block_count;
    const std::size_t pixels = static_cast<std::size_t>(image.size.x) * static_cast<std::size_t>(image.size.y);
    std::vector<glm::vec4> sum(pixels);
    image.mean.resize(pixels);
    image.variance.resize(pixels);
    const auto points = static_cast<std::uint32_t>(options.footprint_samples);
    image.samples.assign(pixels, points * frame_count);
    targets.read(Targets::Picture::sum, 0, &sum[0].x);
    targets.read(Targets::Picture::mean, 0, &image.mean[0].x);
    targets.read(Targets::Picture::spread, 0, &image.variance[0].x);
    if (options.knows_spread) {
        image.frame_variance.resize(pixels);
        targets.read(Targets::Picture::squares, 0, &image.frame_variance[0].x);
    }
    if (!tiles.empty() && block_count >= 2) return read_tiled(std::move(image));
    const double samples = std::max(frame_count, 1u);
    const double of_blocks = block_count * length / samples; // of tiles: there is one at the most
    const double n = block_count;
    const double of_mean = n > 1 ? 1 / (n * (n - 1)) : 0;
    for (std::size_t k = 0; k < pixels; ++k) {
        image.mean[k] = glm::vec4(glm::dvec4(image.mean[k]) * of_blocks + glm::dvec4(sum[k]) / samples);
        image.variance[k] = glm::vec4(glm::dvec4(image.variance[k]) * of_mean);
    }
    add_frame_variance(image);
    return image;
}

// The squares have been read.
void Preview::add_frame_variance(PreviewImage& image) const
{
    const auto points = static_cast<std::uint32_t>(options.footprint_samples);
    for (std::size_t k = 0; k < image.frame_variance.size(); ++k) {
        const double n = image.samples[k] / points;
        const glm::dvec4 mean(image.mean[k]), square(image.frame_variance[k]);
        const glm::dvec4 spread = glm::max(square / std::max(n, 1.0) - mean * mean, glm::dvec4(0));
        image.frame_variance[k] = n > 1 ? glm::vec4(spread / (n - 1)) : glm::vec4(0);
    }
}

// As Renderer::pixel_estimate() of the reference. What the image has got so far is the even half.
PreviewImage Preview::read_tiled(PreviewImage image) const
{
    const std::size_t pixels = image.mean.size();
    const auto points = static_cast<std::uint32_t>(options.footprint_samples);
    std::vector<glm::vec4> mean[2], spread[2], kept(pixels), kept_noise(pixels);
    mean[0] = std::move(image.mean);
    spread[0] = std::move(image.variance);
    mean[1].resize(pixels);
    spread[1].resize(pixels);
    targets.read(Targets::Picture::mean, 1, &mean[1][0].x);
    targets.read(Targets::Picture::spread, 1, &spread[1][0].x);
    targets.read(Targets::Picture::kept, 0, &kept[0].x);
    targets.read(Targets::Picture::kept_noise, 0, &kept_noise[0].x);
    image.mean.resize(pixels);
    image.variance.resize(pixels);
    const int columns = targets.tiles().x;
    for (std::size_t k = 0; k < pixels; ++k) {
        const int x = static_cast<int>(k) % image.size.x, y = static_cast<int>(k) / image.size.x;
        const TileState& tile = tiles[static_cast<std::size_t>(y / tile_side * columns + x / tile_side)];
        image.samples[k] = static_cast<std::uint32_t>(samples_of(tile)) * points;
        glm::dvec4 sum(kept[k]), noise(glm::vec3(kept_noise[k]), 0);
        for (int half = 0; half < 2; ++half) {
            if (tile.kept[half] > 0) continue;
            const double n = blocks_of(half);
            sum += 0.5 * glm::dvec4(mean[half][k]);
            if (n > 1) noise += 0.25 / (n * (n - 1)) * glm::dvec4(glm::vec3(spread[half][k]), 0);
        }
        image.mean[k] = glm::vec4(sum);
        image.variance[k] = glm::vec4(noise);
    }
    add_frame_variance(image);
    return image;
}

std::string Preview::reload_shaders()
{
    if (passes.rebuild_if_changed()) restart();
    return passes.complaint();
}

std::vector<std::string> Preview::features() const
{
    // Names alone; definitions with a value are the model's, which reports itself.
    std::vector<std::string> names;
    for (const std::string& define : passes.features())
        if (define.find(' ') == std::string::npos) names.push_back(define);
    return names;
}

std::vector<std::string> Preview::pass_names() const
{
    std::vector<std::string> names;
    const std::string computed = computes() ? "-compute" : "";
    if (!needs.camera_rays && !buffers.opaque.empty()) names.emplace_back("visibility");
    if (!needs.camera_rays && !buffers.gauze.empty()) names.emplace_back("visibility-gaps");
    if (has_past) names.emplace_back("carry");
    names.emplace_back((needs.camera_rays ? "shade-rays" : "shade") + computed);
    if (needs.seen && computed.empty()) names.emplace_back("background");
    names.emplace_back("merge");
    if (options.target_error > 0)
        for (const char* name : {"judge", "keep"}) names.emplace_back(name);
    return names;
}

} // namespace selvedge
