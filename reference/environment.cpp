// Environment tables: cleaning, densities, inverted distributions; the alias method. Internal to the scene loader.
#include "reference/environment.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bake/error.hpp"
#include "bake/image.hpp"

namespace selvedge
{

namespace
{

constexpr float half_float_max = 65504.0f; // what an infinite texel becomes: the brightest that a half EXR can hold

double luminance(glm::vec4 colour)
{
    return 0.2126 * double(colour.x) + 0.7152 * double(colour.y) + 0.0722 * double(colour.z);
}

// Solid angle of a texel of row y over 2 pi / width.
double row_measure(int y, int height)
{
    const double step = std::numbers::pi / height;
    return std::cos(step * y) - std::cos(step * (y + 1));
}

void build_table(Environment& environment, const std::vector<double>& probability)
{
    double total = 0.0;
    for (const double p : probability) total += p;
    for (std::size_t i = 0; i < probability.size(); ++i)
        environment.texels[i].w = float(probability[i] * double(probability.size()) / total);
    environment.inversion = inversion_table(probability, environment.size);
}

// Of `count` weights: where the share of each ends, and which to begin with for each 1 / count of the fractions.
void fill_inversion(const double* weights, std::uint32_t count, glm::uvec2* table)
{
    double total = 0.0;
    for (std::uint32_t k = 0; k < count; ++k) total += weights[k];
    double sum = 0.0;
    for (std::uint32_t k = 0; k < count; ++k) {
        sum += weights[k];
        const double end = k + 1 < count && total > 0.0 ? sum / total * 4294967296.0 : 4294967295.0;
        table[k].x = std::uint32_t(std::min(end, 4294967295.0));
    }
    std::uint32_t at = 0;
    for (std::uint32_t k = 0; k < count; ++k) {
        const std::uint64_t lowest = ((std::uint64_t(k) << 32) + count - 1) / count; // bits of this part
        while (at + 1 < count && table[at].x <= lowest) ++at;
        table[k].y = at;
    }
}

// Halves a picture in both directions; the rows of a latitude-longitude picture are averaged as they are.
std::vector<glm::vec4> halved(const std::vector<glm::vec4>& texels, glm::ivec2 size, glm::ivec2& out)
{
    out = {std::max(size.x / 2, 1), std::max(size.y / 2, 1)};
    std::vector<glm::vec4> result(std::size_t(out.x) * std::size_t(out.y));
    for (int y = 0; y < out.y; ++y)
        for (int x = 0; x < out.x; ++x) {
            glm::vec4 sum(0.0f);
            for (int k = 0; k < 4; ++k) {
                const int sx = std::min(2 * x + (k & 1), size.x - 1), sy = std::min(2 * y + (k >> 1), size.y - 1);
                sum += texels[std::size_t(sy) * std::size_t(size.x) + std::size_t(sx)];
            }
            result[std::size_t(y) * std::size_t(out.x) + std::size_t(x)] = sum * 0.25f;
        }
    return result;
}

} // namespace

std::vector<glm::uvec2> inversion_table(const std::vector<double>& weights, glm::ivec2 size)
{
    const std::size_t w = std::size_t(size.x), h = std::size_t(size.y);
    std::vector<glm::uvec2> table((h + (h + w - 1) / w) * w, glm::uvec2(0));
    std::vector<double> rows(h, 0.0);
    for (std::size_t y = 0; y < h; ++y) {
        for (std::size_t x = 0; x < w; ++x) rows[y] += weights[y * w + x];
        fill_inversion(weights.data() + y * w, std::uint32_t(w), table.data() + y * w);
    }
    fill_inversion(rows.data(), std::uint32_t(h), table.data() + w * h);
    return table;
}

std::vector<glm::uvec2> alias_table(const std::vector<double>& weights, std::vector<double>& scaled)
{
    const std::size_t count = weights.size();
    double total = 0.0;
    for (const double w : weights) total += w;
    std::vector<glm::uvec2> table(count);
    scaled.resize(count);
    std::vector<std::uint32_t> small, large;
    for (std::size_t i = 0; i < count; ++i) {
        scaled[i] = weights[i] * double(count) / total;
        (scaled[i] < 1.0 ? small : large).push_back(std::uint32_t(i));
    }
    std::vector<double> left = scaled;
    while (!small.empty() && !large.empty()) {
        const std::uint32_t low = small.back(), high = large.back();
        small.pop_back();
        table[low] = {std::uint32_t(std::min(left[low] * 4294967296.0, 4294967295.0)), high};
        left[high] -= 1.0 - left[low];
        if (left[high] < 1.0) {
            large.pop_back();
            small.push_back(high);
        }
    }
    // What is left over is 1 up to rounding: it keeps itself.
    for (const std::uint32_t i : small) table[i] = {0xffffffffu, i};
    for (const std::uint32_t i : large) table[i] = {0xffffffffu, i};
    return table;
}

Environment load_environment(const std::string& path, std::vector<std::string>& warnings)
{
    const Image image = read_image(path);
    int channel[3] = {image.channel("R"), image.channel("G"), image.channel("B")};
    if (image.channel_count() == 1) channel[0] = channel[1] = channel[2] = 0;
    if (channel[0] < 0 || channel[1] < 0 || channel[2] < 0) {
        std::string found;
        for (const std::string& name : image.channels) found += (found.empty() ? "" : ", ") + name;
        throw InputError(path, 0, "found channels %s, expected R, G and B", found.c_str());
    }

    Environment environment;
    environment.size = {image.width, image.height};
    environment.texels.resize(std::size_t(image.width) * std::size_t(image.height));
    std::size_t negative = 0, not_a_number = 0, infinite = 0, at = 0;
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x, ++at)
            for (int c = 0; c < 3; ++c) {
                float value = image.at(x, y)[channel[c]];
                if (std::isnan(value)) {
                    ++not_a_number;
                    value = 0.0f;
                } else if (std::isinf(value) && value > 0.0f) {
                    ++infinite;
                    value = half_float_max;
                } else if (value < 0.0f) {
                    ++negative;
                    value = 0.0f;
                }
                environment.texels[at][c] = value;
            }
    if (negative + not_a_number + infinite > 0)
        warnings.push_back(format_text("%s: %zu negative and %zu NaN values taken as 0, %zu infinite ones as %g",
                                       path.c_str(), negative, not_a_number, infinite, double(half_float_max)));
    if (image.width != 2 * image.height)
        warnings.push_back(format_text("%s: %d x %d pixels, expected twice as wide as high (latitude-longitude)",
                                       path.c_str(), image.width, image.height));
    while (environment.size.x > environment_width_limit || environment.size.y > environment_width_limit) {
        glm::ivec2 size;
        environment.texels = halved(environment.texels, environment.size, size);
        environment.size = size;
    }

    // The density of a texel is its mean radiance after the bilinear filter: wherever the filtered picture shines at
    // all, the density is above 0, which cloth_direct's MIS relies on.
    const int w = environment.size.x, h = environment.size.y;
    std::vector<double> probability(std::size_t(w) * std::size_t(h));
    double total = 0.0;
    for (int y = 0; y < h; ++y) {
        const double measure = row_measure(y, h);
        for (int x = 0; x < w; ++x) {
            double mean = 0.0;
            for (int j = -1; j <= 1; ++j)
                for (int i = -1; i <= 1; ++i) {
                    const int sx = (x + i + w) % w, sy = std::clamp(y + j, 0, h - 1);
                    mean += (i == 0 ? 0.75 : 0.125) * (j == 0 ? 0.75 : 0.125) *
                            luminance(environment.texels[std::size_t(sy) * std::size_t(w) + std::size_t(sx)]);
                }
            total += probability[std::size_t(y) * std::size_t(w) + std::size_t(x)] = mean * measure;
        }
    }
    if (!(total > 0.0))
        throw InputError(path, 0, "found a picture that is black all over, expected an environment that shines");
    build_table(environment, probability);
    return environment;
}

Environment constant_environment(glm::vec3 radiance)
{
    constexpr int rows = 64; // density within a row is constant over v: enough rows make it follow the sine
    Environment environment;
    environment.size = {1, rows};
    environment.texels.assign(rows, glm::vec4(radiance, 0.0f));
    std::vector<double> probability(rows);
    for (int y = 0; y < rows; ++y) probability[std::size_t(y)] = row_measure(y, rows);
    build_table(environment, probability);
    return environment;
}

double mean_luminance(const Environment& environment)
{
    double sum = 0.0;
    std::size_t at = 0;
    for (int y = 0; y < environment.size.y; ++y) {
        double row = 0.0;
        for (int x = 0; x < environment.size.x; ++x, ++at) row += luminance(environment.texels[at]);
        sum += row * row_measure(y, environment.size.y);
    }
    return environment.size.x > 0 ? sum / (2.0 * environment.size.x) : 0.0;
}

} // namespace selvedge
