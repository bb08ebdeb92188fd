// reference/flip.hpp: the LDR-FLIP perceptual difference of two pictures. metrics.cpp and tests include it.
#pragma once

#include <vector>

namespace selvedge
{

// 0.7 m from a display 0.7 m and 3840 pixels wide, the publication's default.
inline constexpr float flip_pixels_per_degree = 67.0206f;

// Per-pixel difference as seen when flipping between two pictures on a display, 0 same, 1 worst.
//   source             Andersson, Nilsson, Akenine-Moeller, Oskarsson, Astrom, Fairchild 2020, "FLIP: A Difference
//                      Evaluator for Alternating Images", PACM CGIT 3(2); constants as published there
//   reference, test    width * height * 3 display code values (sRGB) in [0, 1], row by row; other values are clamped
//   pixels_per_degree  of visual angle, [1, 1000]; the filters grow with it
//   return             width * height values
std::vector<float> flip_map(const std::vector<float>& reference, const std::vector<float>& test, int width, int height,
                            float pixels_per_degree = flip_pixels_per_degree);

} // namespace selvedge
