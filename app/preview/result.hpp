// app/preview/result.hpp: the preview's picture as reference/film.hpp writes it. Included by preview.cpp, headless.cpp
// and window.cpp.
#pragma once

#include "app/preview/preview.hpp"
#include "reference/film.hpp"

namespace selvedge
{

// Variances are those of blocks; while there are few, of frames if they are known.
inline RenderResult result_of(const PreviewImage& image)
{
    const bool few = image.blocks < 16 && !image.frame_variance.empty();
    RenderResult result(image.size.x, image.size.y);
    result.alpha.resize(image.mean.size());
    for (std::size_t k = 0; k < image.mean.size(); ++k) {
        result.mean[k] = glm::vec3(image.mean[k]);
        result.variance[k] = glm::vec3(few ? image.frame_variance[k] : image.variance[k]);
        result.alpha[k] = image.mean[k].w;
        result.samples[k] = image.samples[k];
    }
    return result;
}

} // namespace selvedge
