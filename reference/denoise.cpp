// reference/denoise.cpp: non-local means. Bands of rows run in parallel; inside one, an offset at a time, so that all
// loops run along rows.
#include "reference/denoise.hpp"

#include <algorithm>
#include <cmath>

#include <tbb/parallel_for.h>

namespace selvedge
{
namespace
{

// By the relMSE that is left of demo, cylinder_satin and layers with 4 to 256 samples at 96 x 96 and 256 x 256: with
// windows of 7 x 7 to 15 x 15, patches of 3 x 3 and 5 x 5, k from 0.6 to 1.1, and without the Gaussian. None is the
// best for all.
constexpr int reach = 5;            // of the window: offsets of up to so many pixels along either axis
constexpr int patch = 1;            // neighbourhoods of 3 x 3 pixels are compared
constexpr float strictness = 0.75f; // k of the paper: differences in units of it and the noise
constexpr float spread = 3.0f;      // standard deviation of the Gaussian [px]
constexpr int border = reach + patch;
constexpr int band = 16; // rows that a thread takes at once

using Plane = std::vector<float>;

std::size_t area(int width, int height)
{
    return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
}

// Row-major with a border of mirrored pixels.
struct Padded {
    int width, height, pitch;
    Plane values;

    Padded(int w, int h) : width(w), height(h), pitch(w + 2 * border), values(area(pitch, h + 2 * border)) {}
    float* row(int y) { return values.data() + (y + border) * std::ptrdiff_t(pitch) + border; }
    const float* row(int y) const { return values.data() + (y + border) * std::ptrdiff_t(pitch) + border; }

    void mirror()
    {
        const auto inside = [](int k, int n) {
            k = (k % (2 * n) + 2 * n) % (2 * n);
            return k < n ? k : 2 * n - 1 - k;
        };
        for (int y = 0; y < height; ++y)
            for (int x = 1; x <= border; ++x) {
                row(y)[-x] = row(y)[inside(-x, width)];
                row(y)[width - 1 + x] = row(y)[inside(width - 1 + x, width)];
            }
        for (int y = 1; y <= border; ++y)
            for (const int at : {-y, height - 1 + y})
                std::copy_n(row(inside(at, height)) - border, pitch, row(at) - border);
    }
};

struct Input {
    Padded r, g, b, alpha;
    Padded noise;  // variance of the three channels together, averaged over 3 x 3 pixels: by itself it is noisy
    Padded counts; // 1 with samples, 0 without

    explicit Input(const RenderResult& result)
        : r(result.width, result.height), g(r), b(r), alpha(r), noise(r), counts(r)
    {
        Padded own(r);
        each([&](int x, int y, std::size_t at) {
            const glm::vec3 mean = result.mean[at], variance = result.variance[at];
            r.row(y)[x] = mean.x, g.row(y)[x] = mean.y, b.row(y)[x] = mean.z;
            alpha.row(y)[x] = result.alpha.empty() ? 1.0f : result.alpha[at];
            counts.row(y)[x] = result.samples[at] > 0 ? 1.0f : 0.0f;
            own.row(y)[x] = variance.x + variance.y + variance.z;
        });
        own.mirror();
        each([&](int x, int y, std::size_t) {
            float sum = 0;
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx)
                    sum += own.row(y + dy)[x + dx] * float((2 - std::abs(dx)) * (2 - std::abs(dy)));
            noise.row(y)[x] = std::min(sum / 16, 1e30f); // infinities would cancel to what is no number
        });
        for (Padded* plane : {&r, &g, &b, &alpha, &noise, &counts}) plane->mirror();
    }

    template <typename Body> void each(const Body& body) const
    {
        for (int y = 0; y < r.height; ++y)
            for (int x = 0; x < r.width; ++x) body(x, y, area(r.width, y) + static_cast<std::size_t>(x));
    }
};

// exp(-d) for d >= 0, to 3 % of 1, by products alone.
inline float falling(float d)
{
    const float x = std::max(1.0f - std::max(d, 0.0f) / 16, 0.0f);
    const float x_2 = x * x, x_4 = x_2 * x_2, x_8 = x_4 * x_4;
    return x_8 * x_8;
}

// Sums of weights and weighted values of the rows of a band.
struct Band {
    int first, rows, width;
    Plane r, g, b, alpha, weight;
    Plane difference; // of the rows and `patch` more on either side, over as many columns

    Band(int first_row, int row_count, int w) : first(first_row), rows(row_count), width(w)
    {
        for (Plane* plane : {&r, &g, &b, &alpha, &weight}) plane->assign(area(rows, width), 0.0f);
        difference.resize(area(rows + 2 * patch, pitch()));
    }
    int pitch() const { return width + 2 * patch; }

    void compare(const Input& in, int dx, int dy)
    {
        for (int k = 0; k < rows + 2 * patch; ++k) {
            const int y = first + k - patch;
            const float *r0 = in.r.row(y) - patch, *g0 = in.g.row(y) - patch, *b0 = in.b.row(y) - patch;
            const float *r1 = in.r.row(y + dy) - patch + dx, *g1 = in.g.row(y + dy) - patch + dx;
            const float* b1 = in.b.row(y + dy) - patch + dx;
            const float *n0 = in.noise.row(y) - patch, *n1 = in.noise.row(y + dy) - patch + dx;
            float* out = difference.data() + k * std::ptrdiff_t(pitch());
            const int columns = pitch();
#pragma GCC ivdep
            for (int x = 0; x < columns; ++x) {
                const float red = r0[x] - r1[x], green = g0[x] - g1[x], blue = b0[x] - b1[x];
                const float squared = red * red + green * green + blue * blue;
                out[x] =
                    (squared - n0[x] - std::min(n0[x], n1[x])) / (strictness * strictness * (n0[x] + n1[x]) + 1e-20f);
            }
        }
    }

    void add(const Input& in, int dx, int dy)
    {
        const float near = std::exp(-float(dx * dx + dy * dy) / (2 * spread * spread));
        for (int k = 0; k < rows; ++k) {
            const int y = first + k;
            const float* d0 = difference.data() + k * std::ptrdiff_t(pitch());
            const float *d1 = d0 + pitch(), *d2 = d1 + pitch();
            const float *r1 = in.r.row(y + dy) + dx, *g1 = in.g.row(y + dy) + dx, *b1 = in.b.row(y + dy) + dx;
            const float *a1 = in.alpha.row(y + dy) + dx, *c1 = in.counts.row(y + dy) + dx;
            const std::ptrdiff_t at = k * std::ptrdiff_t(width);
            float *out_r = r.data() + at, *out_g = g.data() + at, *out_b = b.data() + at, *out_a = alpha.data() + at;
            float* out_w = weight.data() + at;
#pragma GCC ivdep // none of the planes is another
            for (int x = 0; x < width; ++x) {
                const float d =
                    (d0[x] + d1[x] + d2[x]) + (d0[x + 1] + d1[x + 1] + d2[x + 1]) + (d0[x + 2] + d1[x + 2] + d2[x + 2]);
                const float w = near * falling(d / 9) * c1[x];
                out_r[x] += w * r1[x], out_g[x] += w * g1[x], out_b[x] += w * b1[x], out_a[x] += w * a1[x];
                out_w[x] += w;
            }
        }
    }
};

} // namespace

bool denoise(RenderResult& result)
{
    if (std::none_of(result.variance.begin(), result.variance.end(),
                     [](glm::vec3 v) { return v.x > 0 || v.y > 0 || v.z > 0; }))
        return false;
    ResultLayer noisy{{"noisy.R", "noisy.G", "noisy.B"}, {}};
    for (const glm::vec3 mean : result.mean) noisy.values.insert(noisy.values.end(), {mean.x, mean.y, mean.z});
    result.layers.push_back(std::move(noisy));
    const Input in(result);
    const int bands = (result.height + band - 1) / band;
    tbb::parallel_for(0, bands, [&](int number) {
        const int first = number * band;
        Band own(first, std::min(band, result.height - first), result.width);
        for (int dy = -reach; dy <= reach; ++dy)
            for (int dx = -reach; dx <= reach; ++dx) {
                own.compare(in, dx, dy);
                own.add(in, dx, dy);
            }
        for (std::size_t k = 0; k < own.weight.size(); ++k) {
            const std::size_t at = area(result.width, first) + k;
            if (result.samples[at] == 0) continue; // all others have a weight of 1 from themselves
            result.mean[at] = glm::vec3(own.r[k], own.g[k], own.b[k]) / own.weight[k];
            if (!result.alpha.empty()) result.alpha[at] = own.alpha[k] / own.weight[k];
        }
    });
    std::fill(result.variance.begin(), result.variance.end(), glm::vec3(0));
    return true;
}

} // namespace selvedge
