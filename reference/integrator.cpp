// Direct and path integrators. Shading comes from glsl/ alone; here are only visibility, order and bookkeeping.
//
// Samples go through in batches, one stage after the other for all of a batch: camera rays, closest hits, surfaces, the
// points of the cloth, light, shadow rays, bounces. So random numbers are drawn for many samples at once, by vector
// instructions; a triangle is fetched once for the samples that meet it; and what the next stage reads of a fabric's
// maps is on its way from memory while others are shaded. Each sample's numbers depend on nothing but itself.
#include "reference/integrator.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>

#include <tbb/blocked_range2d.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

namespace selvedge
{

namespace f32 = cloth::f32;

namespace
{

constexpr int layer_limit = 1024;         // sheets that a ray passes through before it is given up
constexpr std::uint32_t batch_size = 128; // samples; their state, 1 kB each, stays in the second-level cache
constexpr std::uint32_t drawn_count = f32::cloth_dim_lens + 1;

// Makes a large value where it stays. Copied right after it was written in pieces, it would wait for them all.
template <class Value, class Make> void make_in(Value& place, const Make& make)
{
    static_assert(std::is_trivially_destructible_v<Value>);
    ::new (static_cast<void*>(&place)) Value(make());
}

bool is_good(glm::vec3 radiance)
{
    return std::min(radiance.x, std::min(radiance.y, radiance.z)) >= 0.0f &&
           std::isfinite(radiance.x + radiance.y + radiance.z);
}

// The lobes of a yarn's value by themselves: it is a sum over them.
f32::ClothShading only_lobe(const f32::ClothShading& shading, AovIndex term)
{
    f32::ClothShading lobe = shading;
    f32::ClothYarn& yarn = lobe.selection.yarn;
    if (term != aov_index_reflection_specular) yarn.albedo_r = glm::vec3(0.0f);
    if (term != aov_index_reflection_diffuse) yarn.diffuse_r = glm::vec3(0.0f);
    if (term != aov_index_transmission_specular) yarn.albedo_t = glm::vec3(0.0f);
    if (term != aov_index_transmission_diffuse) yarn.diffuse_t = glm::vec3(0.0f);
    if (term != aov_index_multiple_scattering) lobe.between.r = lobe.between.t = glm::vec3(0.0f);
    return lobe;
}

// What sends light on at a surface: the lobes of a fabric; last, matte.
constexpr AovIndex light_terms[] = {aov_index_reflection_specular,   aov_index_reflection_diffuse,
                                    aov_index_transmission_specular, aov_index_transmission_diffuse,
                                    aov_index_multiple_scattering,   aov_index_matte};
constexpr std::size_t light_term_count = std::size(light_terms), matte_term = light_term_count - 1;

} // namespace

int aov_channels(const AovRow& row)
{
    const std::string channels = row.channels;
    return 1 + int(std::count(channels.begin(), channels.end(), ','));
}

int aov_channels(unsigned aovs)
{
    int count = 0;
    for (int k = 0; k < aov_count; ++k)
        if (aovs >> k & 1u) count += aov_channels(aov_rows[k]);
    return count;
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

// Samples on their way, one a lane; and room for each stage's lists of lanes.
struct Renderer::Batch {
    std::uint32_t count = 0;
    std::uint32_t pixel[batch_size]; // of RenderState::pixels
    std::uint64_t block[batch_size];
    std::uint32_t seed[batch_size], index[batch_size];
    std::uint32_t offset = 0;     // first dimension of the present vertex
    glm::ivec2 place[batch_size]; // the pixel's
    glm::uvec2 drawn[batch_size][drawn_count];

    f32::ClothRay ray[batch_size];
    Vertex vertex[batch_size];
    bool met[batch_size], through[batch_size]; // through: passed a cloth before
    glm::vec3 throughput[batch_size], radiance[batch_size];

    std::uint32_t alive_count = 0;
    std::uint32_t alive[batch_size]; // lanes with a vertex, or with a ray to it, in rising order

    // of find_vertices
    std::uint32_t walking[batch_size], found[batch_size];
    float near[batch_size];
    std::uint32_t passed_object[batch_size], passed_triangle[batch_size];
    RayHit hit[batch_size], hit_together[batch_size];
    PencilRay pencil[batch_size];
    f32::ClothDescent descent[batch_size];
    f32::ClothPlace point[batch_size];

    // of add_direct_light, for one slot: [0] by light sampling, [1] by BSDF sampling
    struct Lit {
        std::uint32_t lane;
        int way;
        bool small; // the light
        ShadowRay query;
        std::uint32_t ray; // where in shadow_ray it is
    };
    Lit lit[2 * batch_size];
    f32::ClothDirect light[2][batch_size];
    f32::ClothLightChoice choice[batch_size];
    std::uint32_t sky[batch_size];
    int sky_row[batch_size];
    ShadowRay shadow_ray[2 * batch_size];
    std::vector<CrossedSheet> sheets;
    glm::vec3 arrived[2][batch_size];             // what of the light is not in shadow
    float bright[batch_size];                     // luminance of what has arrived from the lights so far
    glm::vec3 term[light_term_count][batch_size]; // likewise, at the first vertex, by what sends it on

    f32::ClothRandom random(std::uint32_t lane) const { return {seed[lane], index[lane], offset, drawn[lane]}; }

    // Random bits of the given dimensions for lanes[0 .. n), in the streams of seeds[0 .. n).
    void draw(const std::uint32_t* lanes, std::uint32_t n, const std::uint32_t* seeds,
              std::initializer_list<std::uint32_t> dimensions)
    {
        std::uint32_t indices[batch_size], x[batch_size], y[batch_size];
        for (std::uint32_t k = 0; k < n; ++k) indices[k] = index[lanes[k]];
        for (const std::uint32_t dimension : dimensions) {
            for (std::uint32_t k = 0; k < n; ++k) {
                const glm::uvec2 bits = f32::cloth_random_bits(seeds[k], indices[k], offset + dimension);
                x[k] = bits.x;
                y[k] = bits.y;
            }
            for (std::uint32_t k = 0; k < n; ++k) drawn[lanes[k]][dimension] = {x[k], y[k]};
        }
    }
    void draw_alive(std::initializer_list<std::uint32_t> dimensions, int slot = 0) // slot: of the lights
    {
        std::uint32_t seeds[batch_size];
        for (std::uint32_t k = 0; k < alive_count; ++k) seeds[k] = f32::cloth_slot_seed(seed[alive[k]], slot);
        draw(alive, alive_count, seeds, dimensions);
    }
};

Renderer::Renderer(const Scene& scene, const RayScene& rays, const RenderSettings& settings, const PlyScene* plies)
    : scene_(scene), rays_(rays), plies_(plies), settings_(settings),
      camera_(make_camera(scene.camera, settings.resolution)), lens_(lens_of(scene.camera)), lights_(lights_of(scene))
{
    for (const SceneObject& object : scene.objects) {
        maps_.push_back(object.fabric >= 0 ? maps_of(scene.fabrics[std::size_t(object.fabric)]) : f32::ClothMaps{});
        any_fabric_ = any_fabric_ || object.fabric >= 0;
    }
    for (const f32::ClothLight& light : scene.lights) delta_lights_ = delta_lights_ && f32::cloth_light_is_delta(light);
    for (int k = 0; k < aov_count; ++k) {
        const bool asked = settings.aovs >> k & 1u;
        aov_start_[k] = asked ? int(aov_channels_) : -1;
        if (asked) aov_channels_ += std::size_t(aov_channels(aov_rows[k]));
    }
    const glm::ivec4 region = settings.region;
    first_tile_ = {region.x / tile_side, region.y / tile_side};
    tile_count_ =
        glm::ivec2((region.z + tile_side - 1) / tile_side, (region.w + tile_side - 1) / tile_side) - first_tile_;
}

RenderState Renderer::start() const
{
    const std::size_t width = std::size_t(settings_.region.z - settings_.region.x),
                      height = std::size_t(settings_.region.w - settings_.region.y);
    RenderState state;
    state.pixels.resize(width * height);
    state.aovs.assign(width * height * aov_channels_, 0.0);
    if (settings_.target_error > 0.0) {
        state.tiles.resize(std::size_t(tile_count_.x) * std::size_t(tile_count_.y));
        state.kept.assign(2 * width * height, glm::dvec3(0.0));
    }
    return state;
}

// Camera rays of the batch's samples.
void Renderer::begin(Batch& batch, Counters&) const
{
    batch.offset = 0;
    batch.alive_count = batch.count;
    for (std::uint32_t k = 0; k < batch.count; ++k) batch.alive[k] = k;
    batch.draw_alive({f32::cloth_dim_pixel});
    const bool pinhole = lens_.radius <= 0.0f;
    if (!pinhole) batch.draw_alive({f32::cloth_dim_lens});
    for (std::uint32_t k = 0; k < batch.count; ++k) {
        const glm::vec2 u = f32::cloth_draw(batch.random(k), f32::cloth_dim_pixel);
        const glm::vec2 centre = glm::vec2(batch.place[k]) + glm::vec2(0.5f);
        const glm::vec2 raster = centre + f32::cloth_filter_offset(scene_.film.filter, u);
        make_in(batch.ray[k], [&] {
            if (pinhole) return f32::cloth_camera_ray(camera_, raster);
            const glm::vec2 u_lens = f32::cloth_draw(batch.random(k), f32::cloth_dim_lens);
            return f32::cloth_camera_ray(f32::cloth_lens_camera(camera_, lens_, u_lens), raster);
        });
        batch.throughput[k] = glm::vec3(1.0f);
        batch.radiance[k] = glm::vec3(0.0f);
        batch.through[k] = false;
    }
}

// For the rays of all lanes alive: front to back through the sheets to the first surface that the ray does not pass.
// Lanes whose ray meets none are no longer alive.
void Renderer::find_vertices(Batch& batch, bool camera, Counters& counters) const
{
    std::uint32_t walking = batch.alive_count;
    for (std::uint32_t k = 0; k < walking; ++k) {
        const std::uint32_t lane = batch.alive[k];
        batch.walking[k] = lane;
        batch.near[lane] = 0.0f;
        batch.passed_object[lane] = batch.passed_triangle[lane] = ~0u;
        batch.met[lane] = false;
    }
    std::uint32_t seeds[batch_size];
    for (int layer = 0; layer < layer_limit && walking > 0; ++layer) {
        std::uint32_t found = 0, again = 0;
        counters.rays += walking;
        if (camera) {
            for (std::uint32_t k = 0; k < walking; ++k) {
                const std::uint32_t lane = batch.walking[k];
                batch.pencil[k] = {batch.ray[lane].origin, batch.ray[lane].direction, batch.near[lane]};
            }
            rays_.closest_together(batch.pencil, walking, batch.hit_together);
        }
        for (std::uint32_t k = 0; k < walking; ++k) {
            const std::uint32_t lane = batch.walking[k];
            const f32::ClothRay& ray = batch.ray[lane];
            const RayHit hit = camera ? batch.hit_together[k]
                                      : rays_.closest(ray.origin, ray.direction, batch.near[lane],
                                                      std::numeric_limits<float>::infinity());
            if (!hit.any) continue;
            batch.near[lane] = std::nextafter(hit.distance, std::numeric_limits<float>::infinity());
            if (hit.object == batch.passed_object[lane] && hit.triangle == batch.passed_triangle[lane]) {
                batch.walking[again++] = lane;
                continue;
            }
            const Mesh& mesh = scene_.objects[hit.object].mesh;
            __builtin_prefetch(mesh.triangles.data() + hit.triangle);
            __builtin_prefetch(mesh.corner_tiles.data() + 3 * std::size_t(hit.triangle));
            __builtin_prefetch(mesh.tile_base.data() + hit.triangle);
            batch.hit[lane] = hit;
            batch.found[found++] = lane;
        }

        for (std::uint32_t k = 0; k < found; ++k) {
            const RayHit& hit = batch.hit[batch.found[k]];
            const Mesh& mesh = scene_.objects[hit.object].mesh;
            const glm::uvec3 corners = mesh.triangles[hit.triangle];
            for (int c = 0; c < 3; ++c) {
                __builtin_prefetch(mesh.positions.data() + corners[c]);
                __builtin_prefetch(mesh.normals.data() + corners[c]);
            }
        }

        // Surfaces. Neighbouring samples often meet one triangle.
        std::uint32_t fabrics = 0, last_object = ~0u, last_triangle = ~0u;
        f32::ClothTriangle triangle;
        f32::ClothFacet facet;
        for (std::uint32_t k = 0; k < found; ++k) {
            const std::uint32_t lane = batch.found[k];
            const RayHit& hit = batch.hit[lane];
            const SceneObject& object = scene_.objects[hit.object];
            if (hit.object != last_object || hit.triangle != last_triangle) {
                triangle = triangle_of(object, hit.triangle);
                facet = f32::cloth_facet(triangle);
                last_object = hit.object;
                last_triangle = hit.triangle;
            }
            Vertex& vertex = batch.vertex[lane];
            vertex.object = hit.object;
            vertex.triangle = hit.triangle;
            vertex.distance = hit.distance;
            make_in(vertex.surface, [&] { return f32::cloth_surface(triangle, facet, batch.ray[lane]); });
            if (object.fabric < 0) {
                make_in(vertex.shading, [&] { return f32::cloth_shade_plain(object.albedo, object.roughness); });
                batch.met[lane] = true;
                continue;
            }
            seeds[fabrics] =
                f32::cloth_hash_combine(f32::cloth_hash_combine(batch.seed[lane], hit.object), hit.triangle);
            batch.found[fabrics++] = lane;
        }

        // The points of the cloth.
        batch.draw(batch.found, fabrics, seeds, {f32::cloth_dim_footprint, f32::cloth_dim_texel, f32::cloth_dim_pick});
        const f32::ClothSettings& settings = scene_.model.settings;
        const auto footprint_of = [&](const Vertex& vertex) {
            return f32::ClothFootprint{vertex.surface.tile, vertex.surface.tile_dx, vertex.surface.tile_dy,
                                       scene_.objects[vertex.object].mesh.tile_base[vertex.triangle]};
        };
        const auto random_of = [&](std::uint32_t k) {
            f32::ClothRandom random = batch.random(batch.found[k]);
            random.seed = seeds[k];
            return random;
        };
        const bool relief = f32::cloth_follows_relief(settings);
        for (std::uint32_t k = 0; k < fabrics && relief; ++k) {
            const std::uint32_t lane = batch.found[k];
            const Vertex& vertex = batch.vertex[lane];
            const f32::ClothMaps& maps = maps_[vertex.object];
            make_in(batch.descent[lane], [&] {
                return f32::cloth_descent(maps, vertex.surface.side,
                                          f32::cloth_footprint_tile(maps, footprint_of(vertex), random_of(k)),
                                          vertex.surface.wo, f32::cloth_draw(random_of(k), f32::cloth_dim_pick).x);
            });
            f32::cloth_prefetch_height(maps, vertex.surface.side, batch.descent[lane].place);
        }
        for (std::uint32_t k = 0; k < fabrics; ++k) {
            const std::uint32_t lane = batch.found[k];
            const Vertex& vertex = batch.vertex[lane];
            const f32::ClothMaps& maps = maps_[vertex.object];
            const int side = vertex.surface.side;
            batch.point[lane] =
                relief ? f32::cloth_place_at(maps, f32::cloth_descend(maps, side, batch.descent[lane]), 1.0f)
                       : f32::cloth_find(maps, side, footprint_of(vertex), vertex.surface.wo, settings, random_of(k),
                                         f32::cloth_draw(random_of(k), f32::cloth_dim_pick).x);
            f32::cloth_prefetch_texels(maps, batch.point[lane].spot);
            f32::cloth_prefetch_horizons(maps, batch.point[lane].spot);
        }
        for (std::uint32_t k = 0; k < fabrics; ++k) {
            const std::uint32_t lane = batch.found[k];
            Vertex& vertex = batch.vertex[lane];
            f32::ClothSelection& selection = vertex.shading.selection;
            make_in(selection, [&] {
                return f32::cloth_meet(maps_[vertex.object], vertex.surface.side, footprint_of(vertex),
                                       batch.point[lane], vertex.surface.wo, settings,
                                       f32::cloth_draw(batch.random(lane), f32::cloth_dim_pick).y, false);
            });
            if (!selection.passes) {
                // As cloth_shade_fabric, which would copy the selection.
                vertex.shading.matte = false;
                vertex.shading.albedo = glm::vec3(0.0f);
                vertex.shading.roughness = 0.0f;
                vertex.shading.between = f32::cloth_between(selection, settings);
                batch.met[lane] = true;
                continue;
            }
            batch.passed_object[lane] = vertex.object;
            batch.passed_triangle[lane] = vertex.triangle;
            batch.through[lane] = batch.through[lane] || camera;
            batch.walking[again++] = lane;
        }
        walking = again;
    }
    std::uint32_t alive = 0;
    for (std::uint32_t k = 0; k < batch.alive_count; ++k)
        if (batch.met[batch.alive[k]]) batch.alive[alive++] = batch.alive[k];
    batch.alive_count = alive;
}

// Direct light at each vertex, from one light after the other.
//   first  of its path
void Renderer::add_direct_light(Batch& batch, bool first, Counters& counters) const
{
    const int slots = f32::cloth_light_slots(lights_, first);
    const bool by_terms = first && settings_.aovs & aov_terms;
    for (auto& term : batch.term) std::fill_n(term, by_terms ? batch_size : 0, glm::vec3(0.0f));
    if (slots == 0) counters.rays_saved += batch.alive_count;
    for (std::uint32_t k = 0; k < batch.alive_count; ++k) batch.bright[batch.alive[k]] = 0.0f;
    // The sky, which comes first, last: where a sun shines it matters less.
    for (int slot = slots - 1; slot >= 0; --slot) {
        add_light(batch, slot, slots, counters);
        for (std::uint32_t k = 0; k < batch.alive_count && by_terms; ++k) add_light_terms(batch, batch.alive[k]);
    }
}

// From one light a vertex, by light sampling and, where that finds it too, by BSDF sampling. The lights' values first,
// then the shadow rays of those that are not 0.
void Renderer::add_light(Batch& batch, int slot, int slots, Counters& counters) const
{
    for (std::uint32_t k = 0; k < batch.alive_count; ++k)
        for (auto& light : batch.light) light[batch.alive[k]].any = false;
    // Lights without extent are not sampled.
    if (delta_lights_)
        batch.draw_alive({f32::cloth_dim_light}, slot);
    else
        batch.draw_alive({f32::cloth_dim_light, f32::cloth_dim_emitter, f32::cloth_dim_subtexel, f32::cloth_dim_lobe,
                          f32::cloth_dim_direction},
                         slot);
    // The environment's tables are large: first one, then the other is brought for all lanes that will look there.
    std::uint32_t skies = 0;
    for (std::uint32_t k = 0; k < batch.alive_count; ++k) {
        const std::uint32_t lane = batch.alive[k];
        const f32::ClothRandom random = batch.random(lane);
        make_in(batch.choice[lane], [&] {
            return f32::cloth_ask_light(lights_, slot, slots, f32::cloth_draw(random, f32::cloth_dim_light).x);
        });
        if (!f32::cloth_light_is(batch.choice[lane].light, f32::cloth_light_environment)) continue;
        const glm::uvec2 bits = f32::cloth_draw_bits(random, f32::cloth_dim_emitter);
        const int row = f32::cloth_environment_row(lights_, bits.y, 0.0f).at, width = lights_.environment_size.x;
        __builtin_prefetch(lights_.inversion + f32::cloth_inversion_guide(row * width, width, bits.x));
        batch.sky_row[skies] = row;
        batch.sky[skies++] = lane;
    }
    for (std::uint32_t k = 0; k < skies; ++k) {
        const glm::uvec2 bits = f32::cloth_draw_bits(batch.random(batch.sky[k]), f32::cloth_dim_emitter);
        const int width = lights_.environment_size.x, count = width * lights_.environment_size.y;
        const int row = batch.sky_row[k];
        const int texel = row * width + f32::cloth_environment_column(lights_, row, bits.x, 0.0f).at;
        for (const int at : {texel, std::max(texel - width, 0), std::min(texel + width, count - 1)})
            __builtin_prefetch(lights_.environment + at);
    }
    std::uint32_t lit = 0;
    for (std::uint32_t k = 0; k < batch.alive_count; ++k) {
        const std::uint32_t lane = batch.alive[k];
        const Vertex& vertex = batch.vertex[lane];
        const f32::ClothRandom random = batch.random(lane);
        const f32::ClothLightChoice& choice = batch.choice[lane];
        const int ways = settings_.mis && f32::cloth_light_has_two_ways(choice.light, vertex.shading) ? 2 : 1;
        const glm::vec2 u_lobe = ways == 2 ? f32::cloth_draw(random, f32::cloth_dim_lobe) : glm::vec2(0.0f);
        float brings[2] = {0.0f, 0.0f};  // luminance of each way if nothing is in the way
        float full = batch.bright[lane]; // of the sample, without the cloth's own shadow
        for (int way = 0; way < ways; ++way) {
            f32::ClothDirect& light = batch.light[way][lane];
            make_in(light, [&] {
                return f32::cloth_direct_by(lights_, maps_[vertex.object], vertex.surface, vertex.shading,
                                            scene_.model.settings, random, choice, way == 1, ways == 2 ? 1.0f : 0.0f,
                                            u_lobe);
            });
            if (!light.any) continue;
            brings[way] = f32::cloth_luminance(light.value);
            full += brings[way] / light.lit;
        }
        const float u = f32::cloth_draw(random, f32::cloth_dim_light).y;
        // Rays to a light that looks small from everywhere go nearly the same way.
        const bool small =
            f32::cloth_light_is(choice.light, f32::cloth_light_directional) || f32::cloth_light_is_delta(choice.light);
        for (int way = 0; way < ways; ++way) {
            const f32::ClothDirect& light = batch.light[way][lane];
            if (!light.any) {
                ++counters.rays_saved;
                continue;
            }
            // Rays that go together save nothing by a roulette on their way, so they have none there; and none beside
            // other lights, which would cost more in noise than a ray.
            const float least = f32::cloth_least(brings[way], small ? brings[way] / light.lit : full);
            const glm::vec3 normal = vertex.surface.normal_g;
            ShadowRay query = {
                f32::cloth_leave(vertex.surface.position, normal * std::copysign(1.0f, glm::dot(light.wi, normal))),
                light.wi,
                light.distance * (1.0f - 1e-4f),
                small ? 0.0f : least,
                {1.0f, way == 0 ? u : 1.0f - u}}; // the decisions on the two ways are each other's opposites
            query.share = f32::cloth_shadow_roulette(query.share, least);
            if (query.share.left <= 0.0f) {
                batch.arrived[way][lane] = glm::vec3(0.0f);
                continue;
            }
            batch.lit[lit++] = {lane, way, small, query, 0};
        }
    }
    std::uint32_t together = 0, ray = 0;
    for (const bool small : {true, false}) {
        for (std::uint32_t k = 0; k < lit; ++k) {
            if (batch.lit[k].small != small) continue;
            batch.shadow_ray[ray] = batch.lit[k].query;
            batch.lit[k].ray = ray++;
        }
        if (small) together = ray;
    }
    rays_.find_transmittances(batch.shadow_ray, together, lit, scene_.model.settings, batch.sheets);
    for (std::uint32_t k = 0; k < lit; ++k) {
        const auto [lane, way] = std::pair(batch.lit[k].lane, batch.lit[k].way);
        const glm::vec3 value = batch.light[way][lane].value * batch.shadow_ray[batch.lit[k].ray].share.left;
        batch.arrived[way][lane] = value;
        batch.bright[lane] += f32::cloth_luminance(value);
        batch.radiance[lane] += batch.throughput[lane] * value;
    }
    counters.shadow_rays += lit;
}

// From each vertex on: new rays, less the lanes that end here.
void Renderer::bounce(Batch& batch, int depth) const
{
    batch.draw_alive({f32::cloth_dim_lobe, f32::cloth_dim_direction});
    std::uint32_t alive = 0;
    for (std::uint32_t k = 0; k < batch.alive_count; ++k) {
        const std::uint32_t lane = batch.alive[k];
        const Vertex& vertex = batch.vertex[lane];
        const f32::ClothBounce bounce =
            f32::cloth_bounce(maps_[vertex.object], vertex.surface, vertex.shading, scene_.model.settings,
                              batch.random(lane), batch.throughput[lane]);
        if (!bounce.any) continue;
        batch.throughput[lane] = bounce.throughput;
        // Without fabric nothing has a footprint.
        batch.ray[lane] = any_fabric_ ? f32::cloth_bounce_ray(bounce)
                                      : f32::ClothRay{bounce.origin, bounce.wi, glm::vec3(0.0f), glm::vec3(0.0f)};
        batch.alive[alive++] = lane;
    }
    batch.alive_count = alive;
    batch.offset += f32::cloth_dims_per_vertex;
    if (depth <= settings_.roulette_start) return;
    // The row of the pixel filter is free from the second vertex on.
    batch.draw_alive({f32::cloth_dim_pixel});
    alive = 0;
    for (std::uint32_t k = 0; k < batch.alive_count; ++k) {
        const std::uint32_t lane = batch.alive[k];
        const float survive = f32::cloth_survival(batch.throughput[lane]);
        if (f32::cloth_draw(batch.random(lane), f32::cloth_dim_pixel).x >= survive) continue;
        batch.throughput[lane] /= survive;
        batch.alive[alive++] = lane;
    }
    batch.alive_count = alive;
}

void Renderer::add_term(RenderState& state, std::uint32_t pixel, AovIndex term, glm::vec3 value) const
{
    if (aov_start_[term] < 0 || !is_good(value)) return;
    double* sums = state.aovs.data() + pixel * aov_channels_ + aov_start_[term];
    for (int c = 0; c < 3; ++c) sums[c] += double(value[c]);
}

// Layers of the first vertex of a lane, but for its light.
void Renderer::add_first_aovs(Batch& batch, std::uint32_t lane, RenderState& state) const
{
    const Vertex& first = batch.vertex[lane];
    const f32::ClothShading& shading = first.shading;
    const SceneObject& object = scene_.objects[first.object];
    const f32::ClothYarn& yarn = shading.selection.yarn;
    double* const sums = state.aovs.data() + batch.pixel[lane] * aov_channels_;
    const bool first_hit = state.pixels[batch.pixel[lane]].hits == 0.0;
    const auto layer = [&](AovIndex index) { return aov_start_[index] < 0 ? nullptr : sums + aov_start_[index]; };

    if (double* to = layer(aov_index_albedo)) {
        const glm::vec3 albedo =
            shading.matte ? shading.albedo : glm::min(yarn.albedo_r + yarn.diffuse_r + yarn.diffuse_t, glm::vec3(1.0f));
        for (int c = 0; c < 3; ++c) to[c] += double(albedo[c]);
    }
    if (double* to = layer(aov_index_normal))
        for (int c = 0; c < 3; ++c) to[c] += double(first.surface.frame.z[c]);
    if (double* to = layer(aov_index_depth)) *to += double(first.distance); // a camera ray's forward component is 1
    if (first_hit) {
        if (double* to = layer(aov_index_uv))
            for (int c = 0; c < 2; ++c) to[c] = double(first.surface.tile[c] - std::floor(first.surface.tile[c]));
        if (double* to = layer(aov_index_object)) *to = double(first.object + 1);
        if (double* to = layer(aov_index_fabric)) *to = double(object.fabric + 1);
        if (double* to = layer(aov_index_yarn); to && !shading.matte)
            *to = double(scene_.fabrics[std::size_t(object.fabric)].type_of(shading.selection.texel.yarn) + 1);
    }
    if (double* to = layer(aov_index_visibility); to && !shading.matte && lights_.count > 0) {
        // Light sampling alone: cloth_direct's own direction is drawn to fit the fibres.
        const f32::ClothRandom random = batch.random(lane);
        const f32::ClothLightChoice choice =
            f32::cloth_choose_light(lights_, 0, f32::cloth_draw(random, f32::cloth_dim_light).x);
        const f32::ClothLightSample seen = f32::cloth_light_sample(
            lights_, choice.light, first.surface.position, f32::cloth_draw(random, f32::cloth_dim_subtexel),
            f32::cloth_draw_bits(random, f32::cloth_dim_emitter));
        const glm::vec3 wi = f32::cloth_to_local(first.surface.frame, seen.wi);
        const bool reflected = wi.z > 0.0f;
        if (seen.pdf > 0.0f)
            *to += double(f32::cloth_visibility_at(
                maps_[first.object], reflected ? shading.selection.side : 1 - shading.selection.side,
                shading.selection.spot, reflected ? wi : f32::cloth_mirror(wi), scene_.model.settings));
    }
}

// What one light brings to the first vertex of a lane, by what sends it on.
void Renderer::add_light_terms(Batch& batch, std::uint32_t lane) const
{
    const Vertex& first = batch.vertex[lane];
    const f32::ClothShading& shading = first.shading;
    for (int way = 0; way < 2; ++way) {
        if (!batch.light[way][lane].any) continue;
        const glm::vec3 light = batch.arrived[way][lane];
        if (shading.matte) {
            batch.term[matte_term][lane] += light;
            continue;
        }
        const glm::vec3 wi = f32::cloth_to_local(first.surface.frame, batch.light[way][lane].wi);
        const auto value = [&](const f32::ClothShading& lobes) {
            return f32::cloth_shading_value(maps_[first.object], lobes, wi, first.surface.wo, scene_.model.settings);
        };
        const glm::vec3 whole = value(shading);
        for (std::size_t k = 0; k < matte_term; ++k) {
            if (aov_start_[light_terms[k]] < 0) continue;
            glm::vec3 share = value(only_lobe(shading, light_terms[k]));
            for (int c = 0; c < 3; ++c) share[c] = whole[c] > 0.0f ? share[c] / whole[c] : 0.0f;
            batch.term[k][lane] += light * share;
        }
    }
}

// The same among the plies, lane by lane.
void Renderer::trace_plies(Batch& batch, RenderState& state, Counters& counters) const
{
    begin(batch, counters);
    const int depth = settings_.integrator == Integrator::direct ? 1 : settings_.max_depth;
    PlyCounters spent;
    PlyVertex first;
    for (std::uint32_t lane = 0; lane < batch.count; ++lane) {
        PixelSums& sums = state.pixels[batch.pixel[lane]];
        bool hit = false;
        const glm::vec3 radiance =
            plies_->radiance(batch.ray[lane], {batch.seed[lane], batch.index[lane], 0}, depth, spent, first, hit);
        if (hit && aov_channels_ > 0) {
            batch.vertex[lane] = {first.object, 0, first.distance, first.surface, first.shading};
            add_first_aovs(batch, lane, state);
        }
        sums.hits += hit ? 1.0 : 0.0;
        if (is_good(radiance))
            sums.block += glm::dvec3(radiance);
        else
            ++counters.bad_samples;
        if (batch.index[lane] + 1 == settings_.block_length) sums.finish_block(batch.block[lane]);
    }
    counters.rays += spent.rays;
    counters.shadow_rays += spent.shadow_rays;
    counters.rays_saved += spent.rays_saved;
}

// All samples of the batch, into the sums of their pixels in the order of the lanes.
void Renderer::trace(Batch& batch, RenderState& state, Counters& counters) const
{
    if (plies_) {
        trace_plies(batch, state, counters);
        return;
    }
    begin(batch, counters);
    find_vertices(batch, true, counters);
    add_direct_light(batch, true, counters);

    for (std::uint32_t lane = 0; lane < batch.count; ++lane)
        if (!batch.met[lane])
            batch.radiance[lane] = f32::cloth_background(lights_, glm::normalize(batch.ray[lane].direction));
    // What shines is seen by camera rays alone: at a bounce cloth_direct has counted it.
    for (std::uint32_t lane = 0; lane < batch.count && !scene_.emitters.empty(); ++lane) {
        const int light = batch.met[lane] ? scene_.objects[batch.vertex[lane].object].light : -1;
        if (light < 0) continue;
        const glm::vec3 emitted =
            f32::cloth_emitted(scene_.lights[std::size_t(light)], batch.vertex[lane].surface.side);
        batch.radiance[lane] += emitted;
        if (!batch.through[lane]) add_term(state, batch.pixel[lane], aov_index_emission, emitted);
    }
    const bool by_terms = settings_.aovs & aov_terms;
    bool seen[batch_size]; // met[] is overwritten by bounces
    std::copy_n(batch.met, batch.count, seen);
    if (aov_channels_ > 0) {
        for (std::uint32_t lane = 0; lane < batch.count; ++lane) {
            if (seen[lane]) {
                add_first_aovs(batch, lane, state);
                for (std::size_t k = 0; k < light_term_count && by_terms && !batch.through[lane]; ++k)
                    add_term(state, batch.pixel[lane], light_terms[k], batch.term[k][lane]);
            } else if (!batch.through[lane])
                add_term(state, batch.pixel[lane], aov_index_background, batch.radiance[lane]);
            state.pixels[batch.pixel[lane]].hits += seen[lane] ? 1.0 : 0.0;
        }
    } else {
        for (std::uint32_t lane = 0; lane < batch.count; ++lane)
            state.pixels[batch.pixel[lane]].hits += seen[lane] ? 1.0 : 0.0;
    }

    glm::vec3 first_radiance[batch_size];
    if (settings_.aovs & aov_indirect) std::copy_n(batch.radiance, batch.count, first_radiance);
    const int depth_limit = settings_.integrator == Integrator::direct ? 1 : settings_.max_depth;
    for (int depth = 1; depth < depth_limit && batch.alive_count > 0; ++depth) {
        bounce(batch, depth);
        find_vertices(batch, false, counters); // a ray that meets nothing: the environment is counted by cloth_direct
        add_direct_light(batch, false, counters);
    }

    for (std::uint32_t lane = 0; lane < batch.count; ++lane) {
        PixelSums& sums = state.pixels[batch.pixel[lane]];
        const glm::vec3 radiance = batch.radiance[lane];
        if (is_good(radiance))
            sums.block += glm::dvec3(radiance);
        else
            ++counters.bad_samples;
        if (batch.through[lane])
            add_term(state, batch.pixel[lane], aov_index_delta, radiance);
        else if (settings_.aovs & aov_indirect)
            add_term(state, batch.pixel[lane], aov_index_indirect, radiance - first_radiance[lane]);
        if (batch.index[lane] + 1 == settings_.block_length) sums.finish_block(batch.block[lane]);
    }
}

void Renderer::add_samples(RenderState& state, std::uint32_t count) const
{
    const glm::ivec4 region = settings_.region;
    const std::size_t width = std::size_t(region.z - region.x);
    const std::uint64_t pair = 2 * std::uint64_t(settings_.block_length);
    const bool adaptive = !state.tiles.empty();
    std::atomic<std::uint64_t> rays{0}, shadow_rays{0}, rays_saved{0}, bad_samples{0}, skipped{0};
    tbb::enumerable_thread_specific<std::unique_ptr<Batch>> batches([] { return std::make_unique<Batch>(); });
    while (count > 0) {
        // Decisions fall where both halves have the same number of blocks, whatever the steps are.
        const std::uint32_t step =
            adaptive ? std::uint32_t(std::min<std::uint64_t>(count, pair - state.samples % pair)) : count;
        tbb::parallel_for(tbb::blocked_range2d<int>(0, tile_count_.y, 1, 0, tile_count_.x, 1), [&](const auto& range) {
            Counters counters;
            Batch& batch = *batches.local();
            batch.count = 0;
            for (int ty = range.rows().begin(); ty < range.rows().end(); ++ty)
                for (int tx = range.cols().begin(); tx < range.cols().end(); ++tx) {
                    const int x0 = std::max((first_tile_.x + tx) * tile_side, region.x),
                              x1 = std::min((first_tile_.x + tx + 1) * tile_side, region.z);
                    const int y0 = std::max((first_tile_.y + ty) * tile_side, region.y),
                              y1 = std::min((first_tile_.y + ty + 1) * tile_side, region.w);
                    if (adaptive) {
                        TileState& tile = state.tiles[std::size_t(ty * tile_count_.x + tx)];
                        if (tile.done()) {
                            skipped += std::uint64_t(step) * std::uint64_t((x1 - x0) * (y1 - y0));
                            continue;
                        }
                        tile.samples += step;
                    }
                    for (int y = y0; y < y1; ++y)
                        for (int x = x0; x < x1; ++x) {
                            const std::size_t at = std::size_t(y - region.y) * width + std::size_t(x - region.x);
                            const std::uint32_t pixel_seed = f32::cloth_hash_combine(
                                f32::cloth_hash(settings_.seed),
                                std::uint32_t(y) * std::uint32_t(settings_.resolution.x) + std::uint32_t(x));
                            for (std::uint32_t k = 0; k < step; ++k) {
                                const std::uint64_t s = state.samples + k, block = s / settings_.block_length;
                                const std::uint32_t lane = batch.count++;
                                batch.pixel[lane] = std::uint32_t(at);
                                batch.place[lane] = {x, y};
                                batch.block[lane] = block;
                                batch.index[lane] = std::uint32_t(s % settings_.block_length);
                                batch.seed[lane] = f32::cloth_hash_combine(pixel_seed, std::uint32_t(block));
                                if (batch.count == batch_size) {
                                    trace(batch, state, counters);
                                    batch.count = 0;
                                }
                            }
                        }
                }
            if (batch.count > 0) trace(batch, state, counters);
            rays += counters.rays;
            shadow_rays += counters.shadow_rays;
            rays_saved += counters.rays_saved;
            bad_samples += counters.bad_samples;
        });
        state.samples += step;
        count -= step;
        if (adaptive && state.samples % pair == 0 && state.samples / pair >= adaptive_pilot) judge(state);
    }
    state.rays += rays;
    state.shadow_rays += shadow_rays;
    state.rays_saved += rays_saved;
    state.bad_samples += bad_samples;
    state.skipped += skipped;
}

std::size_t Renderer::tile_of(std::size_t pixel) const
{
    const glm::ivec4 region = settings_.region;
    const std::size_t width = std::size_t(region.z - region.x);
    const int x = int(pixel % width) + region.x, y = int(pixel / width) + region.y;
    return std::size_t((y / tile_side - first_tile_.y) * tile_count_.x + x / tile_side - first_tile_.x);
}

// Adaptive sampling: which tiles have come to their end (RenderSettings::target_error).
void Renderer::judge(RenderState& state) const
{
    const double blocks = double(state.samples / (2 * std::uint64_t(settings_.block_length)));
    const double length = double(settings_.block_length);
    std::vector<TileSpread> spreads(state.tiles.size());
    for (std::size_t at = 0; at < state.pixels.size(); ++at) {
        const std::size_t tile = tile_of(at);
        if (state.tiles[tile].done()) continue;
        const PixelSums& sums = state.pixels[at];
        for (int half = 0; half < 2; ++half) {
            const glm::dvec3 mean = sums.total[half] / (blocks * length);
            const glm::dvec3 spread =
                length * block_variance(sums.total[half], sums.squares[half], blocks, settings_.block_length);
            for (int c = 0; c < 3; ++c) spreads[tile].variance[half] += spread[c] / (mean[c] * mean[c] + 0.01);
        }
        spreads[tile].count += 3.0;
    }
    for (TileSpread& spread : spreads)
        for (double& variance : spread.variance) variance /= std::max(spread.count, 1.0);
    const TileStops stops =
        judge_tiles(state.tiles, spreads, state.pilot, state.samples, std::uint32_t(blocks), settings_.target_error);
    for (std::size_t at = 0; at < state.pixels.size(); ++at)
        for (int half = 0; half < 2; ++half)
            if (stops.half[half][tile_of(at)]) state.kept[2 * at + std::size_t(half)] = state.pixels[at].total[half];
}

bool Renderer::finished(const RenderState& state) const
{
    return !state.tiles.empty() && all_done(state.tiles);
}

PixelEstimate Renderer::pixel_estimate(const RenderState& state, std::size_t pixel) const
{
    const PixelSums& sums = state.pixels[pixel];
    const std::uint64_t pair = 2 * std::uint64_t(settings_.block_length);
    if (state.tiles.empty() || state.samples < pair) return estimate(sums, state.samples, settings_.block_length);
    const TileState& tile = state.tiles[tile_of(pixel)];
    const std::uint64_t blocks = tile.samples / settings_.block_length;
    PixelEstimate result;
    for (int half = 0; half < 2; ++half) {
        const double taken = double((blocks + std::uint64_t(1 - half)) / 2);
        const bool decided = tile.kept[half] > 0;
        const double kept = decided ? double(tile.kept[half]) : taken;
        const glm::dvec3 total = decided ? state.kept[2 * pixel + std::size_t(half)] : sums.total[half];
        result.mean += 0.5 * total / (kept * double(settings_.block_length));
        result.variance +=
            0.25 * block_variance(sums.total[half], sums.squares[half], taken, settings_.block_length) / kept;
    }
    return result;
}

RenderResult Renderer::result(const RenderState& state) const
{
    const glm::ivec4 region = settings_.region;
    RenderResult result(settings_.resolution.x, settings_.resolution.y);
    std::vector<int> rows; // of the layers
    for (int k = 0; k < aov_count; ++k) {
        if (aov_start_[k] < 0) continue;
        rows.push_back(k);
        ResultLayer layer;
        const std::string channels = aov_rows[k].channels;
        for (std::size_t from = 0; from <= channels.size();) {
            const std::size_t comma = std::min(channels.find(',', from), channels.size());
            layer.channels.push_back(std::string(aov_rows[k].name) + "." + channels.substr(from, comma - from));
            from = comma + 1;
        }
        layer.values.assign(result.mean.size() * layer.channels.size(), 0.0f);
        result.layers.push_back(std::move(layer));
    }
    std::size_t at = 0;
    for (int y = region.y; y < region.w; ++y)
        for (int x = region.x; x < region.z; ++x, ++at) {
            const std::size_t to = std::size_t(y) * std::size_t(result.width) + std::size_t(x);
            const PixelSums& sums = state.pixels[at];
            const PixelEstimate pixel = pixel_estimate(state, at);
            const std::uint64_t samples = state.tiles.empty() ? state.samples : state.tiles[tile_of(at)].samples;
            result.mean[to] = glm::vec3(pixel.mean);
            result.variance[to] = glm::vec3(pixel.variance);
            result.alpha[to] = samples > 0 ? float(sums.hits / double(samples)) : 0.0f;
            result.samples[to] = std::uint32_t(samples);
            for (std::size_t l = 0; l < rows.size(); ++l) {
                ResultLayer& layer = result.layers[l];
                const std::size_t count = layer.channels.size();
                const AovKind kind = aov_rows[rows[l]].kind;
                const double over = kind == AovKind::first  ? 1.0
                                    : kind == AovKind::hits ? std::max(sums.hits, 1.0)
                                                            : std::max(double(samples), 1.0);
                for (std::size_t c = 0; c < count; ++c)
                    layer.values[to * count + c] =
                        float(state.aovs[at * aov_channels_ + std::size_t(aov_start_[rows[l]]) + c] / over);
            }
        }
    return result;
}

double Renderer::error(const RenderState& state) const
{
    // A half needs two blocks to have a spread.
    const std::uint64_t blocks = state.tiles.empty() ? 2 : 4;
    if (state.samples < blocks * settings_.block_length) return std::numeric_limits<double>::quiet_NaN();
    double sum = 0.0;
    for (std::size_t at = 0; at < state.pixels.size(); ++at) {
        const PixelEstimate pixel = pixel_estimate(state, at);
        for (int c = 0; c < 3; ++c) sum += pixel.variance[c] / (pixel.mean[c] * pixel.mean[c] + 0.01);
    }
    return sum / (3.0 * double(state.pixels.size()));
}

} // namespace selvedge
