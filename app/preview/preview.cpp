// app/preview/preview.cpp: frames, blocks, restarts.
#include "app/preview/preview.hpp"

#include <algorithm>
#include <cmath>

namespace selvedge
{

using namespace cloth::f32;

Preview::Preview(const Scene& from, const GlInfo& gl_info, glm::ivec2 resolution, const PreviewOptions& wanted)
    : scene(from), info(gl_info), options(wanted), camera(from.camera), buffers(gl_info), passes(gl_info)
{
    shape = blocking_shape(scene);
    find_needs();
    buffers.upload(scene, needs);
    targets.resize(resolution, info);
    update_near_plane();
    restart();
}

void Preview::find_needs()
{
    needs = Needs::of(scene, shape, camera, options.footprint_samples, options.max_depth, options.kept);
    passes.choose(needs);
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
    restart();
}

void Preview::resize(glm::ivec2 resolution)
{
    remember();
    targets.resize(resolution, info);
    has_carried = false;
    frame_count = block_count = 0;
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
    return {1 / drawn, static_cast<float>(block_count * length) / drawn, drawn, has_carried ? std::max(left, 0.0f) : 0};
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
    if (!passes.prepare(buffers)) return false;
    if (stale) {
        targets.clear_accumulation();
        has_carried = false;
        frame_count = block_count = 0;
        stale = false;
    }
    const ClothCamera centre = make_camera(camera, targets.size());
    const std::uint32_t view_seed = view_count == 0 ? options.seed : cloth_hash_combine(options.seed, ~view_count);
    const std::uint32_t block_seed = cloth_hash_combine(view_seed, block_count);
    const std::uint32_t index = frame_count % length;
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
    frame.random = glm::uvec4(block_seed, index, static_cast<std::uint32_t>(options.footprint_samples),
                              static_cast<std::uint32_t>(options.max_depth));
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
    buffers.bind_textures();
    passes.visibility(targets, buffers);
    targets.bind_textures();
    passes.shade(targets, buffers);
    if (has_past && frame_count == 0) {
        passes.carry(targets, buffers);
        has_carried = true;
    }
    ++frame_count;
    if (index + 1 == length) passes.merge(targets, length, ++block_count);
    return true;
}

void Preview::present(glm::ivec2 corner, glm::ivec2 size, float exposure)
{
    passes.present(targets, corner, size, shown_weights(), exposure);
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
    targets.read(0, &sum[0].x);
    targets.read(1, &image.mean[0].x);
    targets.read(2, &image.variance[0].x);
    const double samples = std::max(frame_count, 1u);
    const double of_blocks = block_count * length / samples;
    const double n = block_count;
    const double of_mean = n > 1 ? 1 / (n * (n - 1)) : 0;
    for (std::size_t k = 0; k < pixels; ++k) {
        image.mean[k] = glm::vec4(glm::dvec4(image.mean[k]) * of_blocks + glm::dvec4(sum[k]) / samples);
        image.variance[k] = glm::vec4(glm::dvec4(image.variance[k]) * of_mean);
    }
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
    if (!buffers.opaque.empty()) names.emplace_back("visibility");
    if (!buffers.gauze.empty()) names.emplace_back("visibility-gaps");
    if (has_past) names.emplace_back("carry");
    for (const char* name : {"shade", "merge"}) names.emplace_back(name);
    return names;
}

} // namespace selvedge
