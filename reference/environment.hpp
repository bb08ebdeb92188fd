// Environment light from a latitude-longitude picture or one colour: the table that cloth_fetch_environment and
// cloth_fetch_inversion read. The scene loader includes it; both renderers see only the result.
#pragma once

#include <string>
#include <vector>

#include "reference/scene.hpp"

namespace selvedge
{

// Largest table; a larger picture is halved until it fits.
inline constexpr int environment_width_limit = 8192;

// Reads a picture, row 0 at the zenith. Negative and NaN values become 0, infinite ones 65504, each with one warning.
//   throws  InputError as read_image; no colour channels; a picture that is black all over
Environment load_environment(const std::string& path, std::vector<std::string>& warnings);

// The same radiance everywhere: a table one texel wide, so that light sampling is uniform in solid angle.
Environment constant_environment(glm::vec3 radiance);

// Alias table of weights (not all 0): row k is drawn with probability 1 / n, and then stands for itself where 32 random
// bits are below x, for row y otherwise (Walker 1977, built as Vose 1991).
//   scaled  filled with each weight over the mean of all
std::vector<glm::uvec2> alias_table(const std::vector<double>& weights, std::vector<double>& scaled);

// Cumulative distributions of weights (not all 0), ready to be inverted (cloth_invert): of the texels of each row, then
// of the rows; filled up to whole rows with zeros.
std::vector<glm::uvec2> inversion_table(const std::vector<double>& weights, glm::ivec2 size);

// Mean luminance over the sphere: pi times it is the irradiance on a surface in the open.
double mean_luminance(const Environment& environment);

} // namespace selvedge
