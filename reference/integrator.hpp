// The two integrators on the shared shading source: direct light only, and paths. Adds samples to a picture in any
// number of steps; the bits depend on scene, settings and sample count, not on threads or steps. selvedge-render
// includes it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "reference/adaptive.hpp"
#include "reference/film.hpp"
#include "reference/plies.hpp"
#include "reference/rays.hpp"
#include "reference/scene.hpp"

namespace selvedge
{

enum class Integrator { direct, path };

// Layers beside the beauty: name, channels, what is averaged, what it is. Those of the surface are of the first one
// that a camera ray does not pass through. The terms of light add up to the beauty, pixel by pixel, unless samples are
// spread adaptively (then in the mean). Options, pictures and tests go through this list.
//   hits     mean over the samples that met a surface
//   samples  mean over all samples
//   first    the pixel's first sample that met a surface: a mean over an edge would say nothing
#define SELVEDGE_AOVS(ROW)                                                                                             \
    ROW(albedo, "R,G,B", hits, "matte albedo; of a yarn its diffuse and specular ones together, at most 1")            \
    ROW(normal, "X,Y,Z", hits, "shading normal, world")                                                                \
    ROW(depth, "Z", hits, "along the view axis [m]; 0 where nothing was met")                                          \
    ROW(uv, "U,V", first, "place inside the repeat of the fabric, [0, 1)")                                             \
    ROW(object, "ID", first, "1 + index of the object; 0 where nothing was met")                                       \
    ROW(fabric, "ID", first, "1 + index of the fabric; 0 on what has none")                                            \
    ROW(yarn, "ID", first, "1 + yarn type of the fabric; 0 on what has none")                                          \
    ROW(visibility, "V", hits, "V(i): what a yarn sees, past its neighbours, of a direction sampled from the lights")  \
    ROW(reflection_specular, "R,G,B", samples, "direct light: specular lobe of reflection")                            \
    ROW(reflection_diffuse, "R,G,B", samples, "direct light: diffuse reflection")                                      \
    ROW(transmission_specular, "R,G,B", samples, "direct light from behind: specular lobe of transmission")            \
    ROW(transmission_diffuse, "R,G,B", samples, "direct light from behind: diffuse transmission")                      \
    ROW(multiple_scattering, "R,G,B", samples, "direct light that yarns reflect onto each other")                      \
    ROW(matte, "R,G,B", samples, "direct light on objects without fabric")                                             \
    ROW(emission, "R,G,B", samples, "what a camera ray sees of objects that shine")                                    \
    ROW(delta, "R,G,B", samples, "all that a camera ray sees through gaps and between the fibres of a cloth")          \
    ROW(background, "R,G,B", samples, "environment that a camera ray meets at once")                                   \
    ROW(indirect, "R,G,B", samples, "light after a bounce (integrator path)")

enum class AovKind { hits, samples, first };

struct AovRow {
    const char* name;
    const char* channels; // "R,G,B": layer name.R, ...
    AovKind kind;
    const char* help;
};

inline constexpr AovRow aov_rows[] = {
#define ROW(name, channels, kind, help) {#name, channels, AovKind::kind, help},
    SELVEDGE_AOVS(ROW)
#undef ROW
};

enum AovIndex : int {
#define ROW(name, channels, kind, help) aov_index_##name,
    SELVEDGE_AOVS(ROW)
#undef ROW
        aov_count
};

enum AovBit : unsigned {
#define ROW(name, channels, kind, help) aov_##name = 1u << aov_index_##name,
    SELVEDGE_AOVS(ROW)
#undef ROW
};

inline constexpr unsigned aov_terms = aov_reflection_specular | aov_reflection_diffuse | aov_transmission_specular |
                                      aov_transmission_diffuse | aov_multiple_scattering | aov_matte | aov_emission |
                                      aov_delta | aov_background | aov_indirect;

int aov_channels(const AovRow& row);
int aov_channels(unsigned aovs); // of all layers together

struct RenderSettings {
    Integrator integrator = Integrator::path;
    int max_depth = cloth::f32::cloth_path_depth; // surfaces that scatter along a path, at least 1; direct takes 1
    bool mis = true; // lights are looked for by BSDF sampling, too; false: the same mean, more noise
    std::uint32_t seed = 0;
    std::uint32_t block_length = 16; // B of the sampling contract, a power of two
    glm::ivec2 resolution{512, 512};
    glm::ivec4 region{0, 0, 512, 512}; // x0, y0, x1, y1: pixels with x0 <= x < x1, y0 <= y < y1
    unsigned aovs = 0;
    int roulette_start = cloth::f32::cloth_roulette_start; // bounces that Russian roulette never cuts short

    // Above 0: adaptive sampling (adaptive.hpp). Bits are the same for any threads and steps, but a region, whose tiles
    // and mean are others, stops at other counts than the picture does.
    double target_error = 0.0;
};

// Everything that a step of rendering changes.
struct RenderState {
    std::uint64_t samples = 0;     // per pixel of the region, where none was skipped
    std::vector<PixelSums> pixels; // of the region, row by row
    std::vector<double> aovs;      // sums, aov_channels() per pixel
    std::vector<TileState> tiles;  // of the region, row by row; empty unless sampling is adaptive
    std::vector<glm::dvec3> kept;  // two a pixel: sums of the kept blocks of each half; likewise
    double pilot[2] = {0.0, 0.0};  // M as each half sees it; 0: not known yet
    std::uint64_t rays = 0, shadow_rays = 0, rays_saved = 0; // saved: samples whose value was 0 before the shadow ray
    std::uint64_t bad_samples = 0;                           // not finite or negative; counted as 0
    std::uint64_t skipped = 0;                               // samples of tiles that had their error already
};

// The scene and the rays must outlive it.
class Renderer
{
  public:
    //   plies  absent: the surface model; else paths are among the plies themselves
    Renderer(const Scene& scene, const RayScene& rays, const RenderSettings& settings, const PlyScene* plies = nullptr);

    const RenderSettings& settings() const { return settings_; }
    RenderState start() const; // no samples yet
    // `count` more samples for every pixel of the region, on the threads of the calling TBB arena; none for tiles that
    // adaptive sampling has stopped.
    void add_samples(RenderState& state, std::uint32_t count) const;
    bool finished(const RenderState& state) const;       // adaptive sampling has stopped every tile
    RenderResult result(const RenderState& state) const; // full resolution, zeros outside the region
    double error(const RenderState& state) const;        // error_estimate of the region; NaN before two blocks

  private:
    struct Counters;
    struct Vertex;
    struct Batch;
    void begin(Batch& batch, Counters& counters) const;
    void find_vertices(Batch& batch, bool camera, Counters& counters) const;
    void add_direct_light(Batch& batch, bool first, Counters& counters) const;
    void add_light(Batch& batch, int slot, int slots, Counters& counters) const;
    void add_light_terms(Batch& batch, std::uint32_t lane) const;
    void bounce(Batch& batch, int depth) const;
    void trace(Batch& batch, RenderState& state, Counters& counters) const;
    void trace_plies(Batch& batch, RenderState& state, Counters& counters) const;
    void add_first_aovs(Batch& batch, std::uint32_t lane, RenderState& state) const;
    void add_term(RenderState& state, std::uint32_t pixel, AovIndex term, glm::vec3 value) const;
    void judge(RenderState& state) const;
    PixelEstimate pixel_estimate(const RenderState& state, std::size_t pixel) const;
    std::size_t tile_of(std::size_t pixel) const;

    const Scene& scene_;
    const RayScene& rays_;
    const PlyScene* plies_;
    RenderSettings settings_;
    cloth::f32::ClothCamera camera_;
    cloth::f32::ClothLens lens_;
    cloth::f32::ClothLights lights_;
    std::vector<cloth::f32::ClothMaps> maps_;       // per object
    bool any_fabric_ = false, delta_lights_ = true; // delta: no light has extent
    int aov_start_[aov_count];                      // first channel of each layer, -1: not asked for
    std::size_t aov_channels_ = 0;
    glm::ivec2 first_tile_{0}, tile_count_{0};
};

} // namespace selvedge
