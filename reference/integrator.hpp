// The two integrators on the shared shading source: direct light only, and paths. Adds samples to a picture in any
// number of steps; the bits depend on scene, settings and sample count, not on threads or steps. selvedge-render
// includes it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "reference/film.hpp"
#include "reference/rays.hpp"
#include "reference/scene.hpp"

namespace selvedge
{

enum class Integrator { direct, path };

// Layers beside the beauty, of the first surface that a camera ray does not pass through. Means over the samples that
// met one, but for uv, which is the pixel's first such sample (its mean over a seam would say nothing).
enum AovBit : unsigned {
    aov_normal = 1, // normal.X Y Z: shading normal, world
    aov_depth = 2,  // depth.Z: along the view axis [m]; 0 where nothing was met
    aov_uv = 4,     // uv.U V: place inside the repeat of the fabric, [0, 1)
    aov_albedo = 8  // albedo.R G B: matte albedo; of a yarn its diffuse and specular albedos added up, at most 1
};

struct RenderSettings {
    Integrator integrator = Integrator::path;
    int max_depth = 32; // surfaces that scatter along a path, at least 1; direct takes 1
    std::uint32_t seed = 0;
    std::uint32_t block_length = 16; // B of the sampling contract, a power of two
    glm::ivec2 resolution{512, 512};
    glm::ivec4 region{0, 0, 512, 512}; // x0, y0, x1, y1: pixels with x0 <= x < x1, y0 <= y < y1
    unsigned aovs = 0;
};

// Everything that a step of rendering changes.
struct RenderState {
    std::uint64_t samples = 0;                               // per pixel of the region
    std::vector<PixelSums> pixels;                           // of the region, row by row
    std::vector<double> aovs;                                // sums, aov_channels() per pixel
    std::uint64_t rays = 0, shadow_rays = 0, rays_saved = 0; // saved: samples whose value was 0 before the shadow ray
    std::uint64_t bad_samples = 0;                           // not finite or negative; counted as 0
};

// The scene and the rays must outlive it.
class Renderer
{
  public:
    Renderer(const Scene& scene, const RayScene& rays, const RenderSettings& settings);

    const RenderSettings& settings() const { return settings_; }
    RenderState start() const; // no samples yet
    // `count` more samples for every pixel of the region, on the threads of the calling TBB arena.
    void add_samples(RenderState& state, std::uint32_t count) const;
    RenderResult result(const RenderState& state) const; // full resolution, zeros outside the region
    double error(const RenderState& state) const;        // error_estimate of the region; NaN before two blocks
    // Radiance along one camera ray: sample `index` of block `block` of a pixel.
    glm::vec3 sample_pixel(glm::ivec2 pixel, std::uint32_t block, std::uint32_t index) const;

  private:
    struct Counters;
    struct Vertex;
    bool find_vertex(Vertex& vertex, const cloth::f32::ClothRay& ray, cloth::f32::ClothRandom random,
                     Counters& counters) const;
    glm::vec3 direct_light(const Vertex& vertex, cloth::f32::ClothRandom random, Counters& counters) const;
    glm::vec3 sample(glm::ivec2 pixel, std::uint32_t block, std::uint32_t index, Counters& counters, Vertex& first,
                     bool& hit) const;
    void add_aovs(double* sums, const Vertex& first, bool first_hit) const;

    const Scene& scene_;
    const RayScene& rays_;
    RenderSettings settings_;
    cloth::f32::ClothCamera camera_;
    cloth::f32::ClothLights lights_;
    std::vector<cloth::f32::ClothMaps> maps_; // per object
};

int aov_channels(unsigned aovs);

} // namespace selvedge
