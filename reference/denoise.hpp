// Takes noise out of a picture that knows its own: non-local means. Included by the programs that write or show
// pictures.
#pragma once

#include "reference/film.hpp"

namespace selvedge
{

inline constexpr const char* denoise_help = "average each pixel with those around it that differ by no more than their "
                                            "noise; the picture as it was is the EXR's "
                                            "layer noisy";
inline constexpr const char* denoised_by = "non-local means"; // in headers: selvedge:denoised
inline constexpr const char* noise_unknown =
    "--denoise: too few samples to know their noise, the picture stays as it is";

// Averages the radiance and coverage of every pixel with those of pixels around it whose neighbourhoods differ by no
// more than both of their variances explain. What has more samples is averaged less, so that the picture goes to the
// same limit as without; until then it is biased where cloth has detail that drowns in the noise. Pixels without
// samples stay as they are and count for nobody.
//   result  gets mean and alpha as described, variance 0, that is unknown, and a layer "noisy" with the mean that was
//   return  false: no pixel knows its variance, and nothing was changed
//   source  Rousselle, Knaus, Zwicker 2012, "Adaptive Rendering with Non-Local Means Filtering", section 4; with the
//           distance of colours in place of that of channels, and a Gaussian over the distance in the picture
bool denoise(RenderResult& result);

} // namespace selvedge
