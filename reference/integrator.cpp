// Direct and path integrators. Shading comes from glsl/ alone; here are only visibility, order and bookkeeping.
#include "reference/integrator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <tbb/blocked_range2d.h>
#include <tbb/parallel_for.h>

namespace selvedge
{

namespace f32 = cloth::f32;

namespace
{

constexpr int tile_side = 16;
constexpr int layer_limit = 1024; // sheets that a ray passes through before it is given up
constexpr int roulette_start = 3; // bounces that are never cut short

// A bounce has no pixel; it sees as wide a spot as its lobe is wide: half the side of a square of solid angle 1/pdf. So
// a diffuse bounce averages over repeats of a fabric, which is what it would do with many samples (math.md 10, hazard
// 18).
constexpr float bounce_spread_min = 1e-3f, bounce_spread_max = 0.25f;

f32::ClothRay bounce_ray(glm::vec3 origin, glm::vec3 direction, float pdf)
{
    const float spread = std::clamp(0.5f / std::sqrt(pdf), bounce_spread_min, bounce_spread_max);
    const f32::ClothFrame frame = f32::cloth_frame(direction);
    return {origin, direction, frame.x * spread, frame.y * spread};
}

float largest(glm::vec3 v)
{
    return std::max(v.x, std::max(v.y, v.z));
}

} // namespace

int aov_channels(unsigned aovs)
{
    return (aovs & aov_normal ? 3 : 0) + (aovs & aov_depth ? 1 : 0) + (aovs & aov_uv ? 2 : 0) +
           (aovs & aov_albedo ? 3 : 0);
}

struct Renderer::Counters {
    std::uint64_t rays = 0, shadow_rays = 0, rays_saved = 0, bad_samples = 0;
};

// A surface that scatters, with the point of the cloth that was chosen for it.
struct Renderer::Vertex {
    std::uint32_t object = 0, triangle = 0;
    float distance = 0.0f;
    f32::ClothSurface surface;
    f32::ClothShading shading;
};

Renderer::Renderer(const Scene& scene, const RayScene& rays, const RenderSettings& settings)
    : scene_(scene), rays_(rays), settings_(settings), camera_(make_camera(scene.camera, settings.resolution)),
      lights_(lights_of(scene))
{
    for (const SceneObject& object : scene.objects)
        maps_.push_back(object.fabric >= 0 ? maps_of(scene.fabrics[std::size_t(object.fabric)]) : f32::ClothMaps{});
}

RenderState Renderer::start() const
{
    const std::size_t width = std::size_t(settings_.region.z - settings_.region.x),
                      height = std::size_t(settings_.region.w - settings_.region.y);
    RenderState state;
    state.pixels.resize(width * height);
    state.aovs.assign(width * height * std::size_t(aov_channels(settings_.aovs)), 0.0);
    return state;
}

// Front to back through the sheets: the first surface that the ray does not pass.
bool Renderer::find_vertex(Vertex& vertex, const f32::ClothRay& ray, f32::ClothRandom random, Counters& counters) const
{
    float near = 0.0f;
    std::uint32_t passed_object = ~0u, passed_triangle = ~0u;
    for (int layer = 0; layer < layer_limit; ++layer) {
        ++counters.rays;
        const RayHit hit = rays_.closest(ray.origin, ray.direction, near, std::numeric_limits<float>::infinity());
        if (!hit.any) return false;
        near = std::nextafter(hit.distance, std::numeric_limits<float>::infinity());
        if (hit.object == passed_object && hit.triangle == passed_triangle) continue;
        const SceneObject& object = scene_.objects[hit.object];
        vertex.object = hit.object;
        vertex.triangle = hit.triangle;
        vertex.distance = hit.distance;
        vertex.surface = f32::cloth_surface(triangle_of(object, hit.triangle), ray);
        if (object.fabric < 0) {
            vertex.shading = f32::cloth_shade_matte(object.albedo);
            return true;
        }
        f32::ClothRandom layer_random = random;
        layer_random.seed = f32::cloth_hash_combine(f32::cloth_hash_combine(random.seed, hit.object), hit.triangle);
        const f32::ClothFootprint footprint{vertex.surface.tile, vertex.surface.tile_dx, vertex.surface.tile_dy,
                                            object.mesh.tile_base[hit.triangle]};
        const f32::ClothMaps& maps = maps_[hit.object];
        const f32::ClothSelection selection = f32::cloth_select(maps, vertex.surface.side, footprint, vertex.surface.wo,
                                                                scene_.model.settings, layer_random);
        if (!selection.passes) {
            vertex.shading = f32::cloth_shade_fabric(selection);
            return true;
        }
        passed_object = hit.object;
        passed_triangle = hit.triangle;
    }
    return false;
}

glm::vec3 Renderer::direct_light(const Vertex& vertex, f32::ClothRandom random, Counters& counters) const
{
    const f32::ClothDirect light =
        f32::cloth_direct(lights_, maps_[vertex.object], vertex.surface, vertex.shading, scene_.model.settings, random);
    if (!light.any) {
        ++counters.rays_saved;
        return glm::vec3(0.0f);
    }
    const glm::vec3 normal =
        glm::dot(light.wi, vertex.surface.normal_g) > 0.0f ? vertex.surface.normal_g : -vertex.surface.normal_g;
    const glm::vec3 origin = f32::cloth_leave(vertex.surface.position, normal);
    ++counters.shadow_rays;
    return light.value * rays_.transmittance(origin, light.wi, light.distance * (1.0f - 1e-4f), scene_.model.settings);
}

void Renderer::add_aovs(double* sums, const Vertex& first, bool first_hit) const
{
    if (settings_.aovs & aov_normal)
        for (int c = 0; c < 3; ++c) *sums++ += double(first.surface.frame.z[c]);
    if (settings_.aovs & aov_depth) *sums++ += double(first.distance); // the camera ray's forward component is 1
    if (settings_.aovs & aov_uv)
        for (int c = 0; c < 2; ++c, ++sums)
            if (first_hit) *sums = double(first.surface.tile[c] - std::floor(first.surface.tile[c]));
    if (settings_.aovs & aov_albedo) {
        const f32::ClothYarn& yarn = first.shading.selection.yarn;
        const glm::vec3 albedo = first.shading.matte
                                     ? first.shading.albedo
                                     : glm::min(yarn.albedo_r + yarn.diffuse_r + yarn.diffuse_t, glm::vec3(1.0f));
        for (int c = 0; c < 3; ++c) *sums++ += double(albedo[c]);
    }
}

glm::vec3 Renderer::sample(glm::ivec2 pixel, std::uint32_t block, std::uint32_t index, Counters& counters,
                           Vertex& first, bool& hit) const
{
    const std::uint32_t pixel_index =
        std::uint32_t(pixel.y) * std::uint32_t(settings_.resolution.x) + std::uint32_t(pixel.x);
    f32::ClothRandom random{
        f32::cloth_hash_combine(f32::cloth_hash_combine(f32::cloth_hash(settings_.seed), pixel_index), block), index,
        0u};
    const glm::vec2 centre = glm::vec2(pixel) + glm::vec2(0.5f);
    f32::ClothRay ray = f32::cloth_camera_ray(
        camera_, centre + f32::cloth_filter_offset(scene_.film.filter, f32::cloth_draw(random, f32::cloth_dim_pixel)));

    hit = find_vertex(first, ray, random, counters);
    if (!hit) return f32::cloth_background(lights_, glm::normalize(ray.direction));
    glm::vec3 radiance = direct_light(first, random, counters);
    if (settings_.integrator == Integrator::direct || settings_.max_depth == 1) return radiance;

    Vertex vertex = first;
    glm::vec3 throughput(1.0f);
    for (int depth = 1; depth < settings_.max_depth; ++depth) {
        const f32::ClothSample bounce = f32::cloth_shading_sample(
            vertex.shading, vertex.surface.wo, scene_.model.settings, f32::cloth_draw(random, f32::cloth_dim_lobe),
            f32::cloth_draw(random, f32::cloth_dim_direction));
        if (bounce.pdf <= 0.0f) break;
        const glm::vec3 wi = f32::cloth_to_world(vertex.surface.frame, bounce.wi);
        // As in cloth_direct: both normals must agree on the side.
        const float side = glm::dot(wi, vertex.surface.normal_g);
        if (bounce.wi.z * side <= 0.0f) break;
        throughput *= f32::cloth_shading_value(maps_[vertex.object], vertex.shading, bounce.wi, vertex.surface.wo,
                                               scene_.model.settings) /
                      bounce.pdf;
        if (!(largest(throughput) > 0.0f)) break;

        const glm::vec3 origin =
            f32::cloth_leave(vertex.surface.position, side > 0.0f ? vertex.surface.normal_g : -vertex.surface.normal_g);
        random.offset += f32::cloth_dims_per_vertex;
        if (depth > roulette_start) {
            // The row of the pixel filter is free from the second vertex on.
            const float survive = std::min(largest(throughput), 0.95f);
            if (f32::cloth_draw(random, f32::cloth_dim_pixel).x >= survive) break;
            throughput /= survive;
        }
        ray = bounce_ray(origin, glm::normalize(wi), bounce.pdf);
        if (!find_vertex(vertex, ray, random, counters)) break; // the environment is counted by cloth_direct
        radiance += throughput * direct_light(vertex, random, counters);
    }
    return radiance;
}

glm::vec3 Renderer::sample_pixel(glm::ivec2 pixel, std::uint32_t block, std::uint32_t index) const
{
    Counters counters;
    Vertex first;
    bool hit = false;
    return sample(pixel, block, index, counters, first, hit);
}

void Renderer::add_samples(RenderState& state, std::uint32_t count) const
{
    const glm::ivec4 region = settings_.region;
    const std::size_t width = std::size_t(region.z - region.x);
    const std::size_t channels = std::size_t(aov_channels(settings_.aovs));
    std::atomic<std::uint64_t> rays{0}, shadow_rays{0}, rays_saved{0}, bad_samples{0};
    tbb::parallel_for(tbb::blocked_range2d<int>(region.y, region.w, tile_side, region.x, region.z, tile_side),
                      [&](const tbb::blocked_range2d<int>& tile) {
                          Counters counters;
                          Vertex first;
                          for (int y = tile.rows().begin(); y < tile.rows().end(); ++y)
                              for (int x = tile.cols().begin(); x < tile.cols().end(); ++x) {
                                  const std::size_t at = std::size_t(y - region.y) * width + std::size_t(x - region.x);
                                  PixelSums& sums = state.pixels[at];
                                  for (std::uint32_t k = 0; k < count; ++k) {
                                      const std::uint64_t s = state.samples + k;
                                      const std::uint32_t index = std::uint32_t(s % settings_.block_length);
                                      bool hit = false;
                                      glm::vec3 radiance = sample({x, y}, std::uint32_t(s / settings_.block_length),
                                                                  index, counters, first, hit);
                                      if (!(std::min(radiance.x, std::min(radiance.y, radiance.z)) >= 0.0f) ||
                                          !std::isfinite(radiance.x + radiance.y + radiance.z)) {
                                          ++counters.bad_samples;
                                          radiance = glm::vec3(0.0f);
                                      }
                                      sums.block += glm::dvec3(radiance);
                                      if (hit && channels > 0)
                                          add_aovs(state.aovs.data() + at * channels, first, sums.hits == 0.0);
                                      sums.hits += hit ? 1.0 : 0.0;
                                      if (index + 1 == settings_.block_length) sums.finish_block();
                                  }
                              }
                          rays += counters.rays;
                          shadow_rays += counters.shadow_rays;
                          rays_saved += counters.rays_saved;
                          bad_samples += counters.bad_samples;
                      });
    state.samples += count;
    state.rays += rays;
    state.shadow_rays += shadow_rays;
    state.rays_saved += rays_saved;
    state.bad_samples += bad_samples;
}

RenderResult Renderer::result(const RenderState& state) const
{
    const glm::ivec4 region = settings_.region;
    RenderResult result(settings_.resolution.x, settings_.resolution.y);
    const std::size_t channels = std::size_t(aov_channels(settings_.aovs));
    struct Part {
        unsigned bit;
        std::vector<std::string> names;
    };
    std::vector<std::size_t> layer_start;
    std::size_t start = 0;
    for (const Part& part : {Part{aov_normal, {"normal.X", "normal.Y", "normal.Z"}}, Part{aov_depth, {"depth.Z"}},
                             Part{aov_uv, {"uv.U", "uv.V"}}, Part{aov_albedo, {"albedo.R", "albedo.G", "albedo.B"}}}) {
        if (!(settings_.aovs & part.bit)) continue;
        layer_start.push_back(start);
        start += part.names.size();
        result.layers.push_back({part.names, std::vector<float>(result.mean.size() * part.names.size(), 0.0f)});
    }
    std::size_t at = 0;
    for (int y = region.y; y < region.w; ++y)
        for (int x = region.x; x < region.z; ++x, ++at) {
            const std::size_t to = std::size_t(y) * std::size_t(result.width) + std::size_t(x);
            const PixelSums& sums = state.pixels[at];
            const PixelEstimate pixel = estimate(sums, state.samples, settings_.block_length);
            result.mean[to] = glm::vec3(pixel.mean);
            result.variance[to] = glm::vec3(pixel.variance);
            result.alpha[to] = state.samples > 0 ? float(sums.hits / double(state.samples)) : 0.0f;
            result.samples[to] = std::uint32_t(state.samples);
            for (std::size_t l = 0; l < result.layers.size(); ++l) {
                ResultLayer& layer = result.layers[l];
                const std::size_t count = layer.channels.size();
                const double over = layer.channels[0] == "uv.U" ? 1.0 : std::max(sums.hits, 1.0);
                for (std::size_t c = 0; c < count; ++c)
                    layer.values[to * count + c] = float(state.aovs[at * channels + layer_start[l] + c] / over);
            }
        }
    return result;
}

double Renderer::error(const RenderState& state) const
{
    if (state.samples < 2 * std::uint64_t(settings_.block_length)) return std::numeric_limits<double>::quiet_NaN();
    double sum = 0.0;
    for (const PixelSums& sums : state.pixels) {
        const PixelEstimate pixel = estimate(sums, state.samples, settings_.block_length);
        for (int c = 0; c < 3; ++c) sum += pixel.variance[c] / (pixel.mean[c] * pixel.mean[c] + 0.01);
    }
    return sum / (3.0 * double(state.pixels.size()));
}

} // namespace selvedge
