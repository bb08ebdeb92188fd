// bake/visibility.hpp: height fields to horizons, knots and cosine irradiance. maps -> here -> pack.
#pragma once

#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

namespace selvedge
{

inline constexpr int horizon_azimuths = 32; // swept; knots, Gaussians and caps are fitted to them

// A periodic height field in its own frame (the back's is mirrored): w*h, row 0 at v = 0.
struct HeightField {
    glm::ivec2 size{0};
    glm::vec2 tile_m{0};
    const std::vector<float>* height_m = nullptr;
};

// The horizons of a field as packed knots, (w/2)*(h/2) times knots/8 words: seen from the middle of each 2 x 2 block of
// texels.
//   sweep   s = sin(elevation), clamped to [0, 1] (math.md 8.1), at 32 azimuths next to 2 pi (j + 1/2) / 32: those at
//           which lines close on the periodic tile. Exact and periodic along each line, heights interpolated across it;
//           the cost of a texel does not grow with the size of the tile (Timonen & Westerholm 2010)
//   fit     least squares of the periodic piecewise-linear spline over cloth_horizon_azimuth (math.md 8.5), clamped,
//           quantised to unorm8
//   knots   8 or 16
std::vector<glm::uvec2> horizon_knots(const HeightField& field, int knots = 8);

// The paper's visibility: an anisotropic spherical Gaussian a texel (Eq. 7-8) from a sweep with a receiver in every
// texel, moments in closed form (math.md 8.1, 8.2). 2*w*h records: (mu, gamma about cloth_frame(mu)), (sigma_x,
// sigma_y, amplitude, 0).
//   least_squares  amplitude <V, A> / <A, A> over the hemisphere instead of 1 (8.3)
std::vector<glm::vec4> fit_asg(const HeightField& field, bool least_squares);

// An elliptic cap a texel, w*h words of pack_cap, from the same moments (math.md 8.5).
std::vector<glm::uvec2> fit_cap(const HeightField& field);

// Lowest and highest value.
glm::vec2 height_range(const HeightField& field);

// Horizon from any point (in texels; texel centres at .5) along one azimuth, by brute force: every texel row or column
// that the ray crosses, heights interpolated along it, from 1 texel on, until the highest point of the field could no
// longer raise the horizon, or one tile length and 16 height ranges have passed. The oracle of sweep and fits, for
// tests, reports and benchmarks.
//   range_m  height_range of the field
float march_horizon(const HeightField& field, glm::vec2 range_m, glm::vec2 at_texels, float azimuth);

// I_p of math.md 8.1: (1/pi) INT max(0, n.d) V dd over the hemisphere for each full-resolution texel, from its slope
// (as stored: clamped) and the packed half-resolution knots around it. w*h values in [0, 1].
std::vector<float> cosine_irradiance(const std::vector<glm::uvec2>& knots, const std::vector<glm::vec2>& slopes,
                                     glm::ivec2 size);

} // namespace selvedge
