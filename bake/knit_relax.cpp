// bake/knit_relax.cpp: position-based relaxation of rods on a periodic tile.
#include "knit_relax.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include <tbb/parallel_for.h>

namespace selvedge
{

namespace
{

constexpr float near_by_arc = 3.3f; // along a rod: nearer is the same bend, not a contact (a half turn of radius 1)
constexpr float margin = 0.5f;      // of pairs' distance beyond contact: listed anew when points may have come so near

// Two points near each other; `shift` takes b to its image that is near a.
struct Pair {
    std::uint32_t a, b;
    glm::vec2 shift;
};

// Neighbours along strands and pairs of points near each other.
//
// Pairs lie in strips of the tile, each at least thrice as high as pairs are long: every second strip shares no point
// with the others (nor the next one along a strand), so they are worked at once, with one result for any number of
// threads.
class Neighbours
{
  public:
    explicit Neighbours(const Rods& rods)
    {
        const std::size_t count = rods.point.size();
        strand.resize(count);
        for (std::size_t s = 0; s + 1 < rods.start.size(); ++s)
            for (std::size_t i = rods.start[s]; i < rods.start[s + 1]; ++i) strand[i] = static_cast<std::uint32_t>(s);
    }

    void find(const Rods& rods, float reach)
    {
        cells = glm::max(glm::ivec2(glm::floor(rods.period / reach)), glm::ivec2(1));
        const glm::vec2 scale = glm::vec2(cells) / rods.period;
        const auto one = [](float x, int n) {
            const int i = static_cast<int>(std::floor(x)) % n;
            return i < 0 ? i + n : i;
        };
        const std::size_t cell_count = static_cast<std::size_t>(cells.x) * static_cast<std::size_t>(cells.y);
        first.assign(cell_count + 1, 0);
        cell.resize(rods.point.size());
        for (std::size_t i = 0; i < rods.point.size(); ++i) {
            const glm::vec3 p = rods.point[i];
            cell[i] = static_cast<std::uint32_t>(one(p.y * scale.y, cells.y) * cells.x + one(p.x * scale.x, cells.x));
            ++first[cell[i] + 1];
        }
        for (std::size_t c = 0; c < cell_count; ++c) first[c + 1] += first[c];
        member.resize(rods.point.size());
        fill.assign(first.begin(), first.end() - 1);
        place.resize(rods.point.size());
        for (std::size_t i = 0; i < rods.point.size(); ++i) {
            const std::size_t k = fill[cell[i]]++;
            member[k] = static_cast<std::uint32_t>(i);
            place[k] = rods.point[i];
        }
        strips.resize(static_cast<std::size_t>(std::max(cells.y / 6 * 2, 1)));
        tbb::parallel_for(std::size_t(0), strips.size(), [&](std::size_t s) { find_in_strip(rods, reach, s); });
    }

    // Calls visit(pair) for all pairs, strips that share no point at once.
    template <class Visit> void each(Visit&& visit) const
    {
        for (std::size_t odd = 0; odd < 2; ++odd)
            tbb::parallel_for(std::size_t(0), (strips.size() + 1 - odd) / 2, [&](std::size_t k) {
                for (const Pair& pair : strips[2 * k + odd]) visit(pair);
            });
    }

    std::vector<std::uint32_t> strand;

  private:
    // Along the strand, either way round.
    float arc(const Rods& rods, std::size_t a, std::size_t b) const
    {
        const std::size_t s = strand[a], count = rods.start[s + 1] - rods.start[s];
        const std::size_t steps = a > b ? a - b : b - a;
        return static_cast<float>(std::min(steps, count - steps)) * rods.length[s] / static_cast<float>(count);
    }

    void find_in_strip(const Rods& rods, float reach, std::size_t strip)
    {
        std::vector<Pair>& pairs = strips[strip];
        pairs.clear();
        const int rows = cells.y, share = static_cast<int>(strips.size());
        const int low = rows * static_cast<int>(strip) / share, high = rows * (static_cast<int>(strip) + 1) / share;
        for (int y = low; y < high; ++y)
            for (int x = 0; x < cells.x; ++x) {
                const std::size_t here = static_cast<std::size_t>(y * cells.x + x);
                // Where the tile is only one or two cells wide, -1 and 1 are the same cell: visited once.
                for (int dy = rows > 2 ? -1 : 0; dy <= (rows > 1 ? 1 : 0); ++dy)
                    for (int dx = cells.x > 2 ? -1 : 0; dx <= (cells.x > 1 ? 1 : 0); ++dx) {
                        const std::size_t there =
                            static_cast<std::size_t>((y + dy + rows) % rows * cells.x + (x + dx + cells.x) % cells.x);
                        for (std::size_t k = first[here]; k < first[here + 1]; ++k)
                            for (std::size_t l = first[there]; l < first[there + 1]; ++l)
                                if (member[l] > member[k]) add(rods, reach, k, l, pairs);
                    }
            }
    }

    void add(const Rods& rods, float reach, std::size_t k, std::size_t l, std::vector<Pair>& pairs) const
    {
        const glm::vec3 d = place[l] - place[k];
        glm::vec2 shift(0);
        if (std::abs(d.x) > 0.5f * rods.period.x || std::abs(d.y) > 0.5f * rods.period.y)
            shift = -rods.period * glm::floor(glm::vec2(d) / rods.period + 0.5f);
        const std::uint32_t i = member[k], j = member[l];
        const glm::vec3 between = d + glm::vec3(shift, 0);
        if (glm::dot(between, between) >= reach * reach) return;
        if (strand[i] == strand[j] && arc(rods, i, j) < near_by_arc) return;
        pairs.push_back({i, j, shift});
    }

    glm::ivec2 cells{1};
    std::vector<std::size_t> first, fill;
    std::vector<std::uint32_t> member, cell; // points in the order of their cells; cell of each point
    std::vector<glm::vec3> place;            // of `member`
    std::vector<std::vector<Pair>> strips;
};

glm::vec3 apart(const Rods& rods, const Pair& pair) // from a to b
{
    return rods.point[pair.b] - rods.point[pair.a] + glm::vec3(pair.shift, 0);
}

// Each point a share of the way to the middle of the two that are `stride` before and after it.
void straighten(Rods& rods, std::vector<glm::vec3>& before, std::size_t stride, float share)
{
    before = rods.point;
    tbb::parallel_for(std::size_t(0), rods.start.size() - 1, [&](std::size_t s) {
        const std::size_t low = rods.start[s], count = rods.start[s + 1] - low;
        if (count <= 2 * stride) return;
        for (std::size_t i = 0; i < count; ++i) {
            const glm::vec3 p = before[low + i];
            glm::vec3 a = before[low + (i >= stride ? i - stride : i + count - stride)];
            glm::vec3 b = before[low + (i + stride < count ? i + stride : i + stride - count)];
            if (i < stride) a.x -= rods.period.x;
            if (i + stride >= count) b.x += rods.period.x;
            rods.point[low + i] = p + share * (0.5f * (a + b) - p);
        }
    });
}

void keep_lengths(Rods& rods, bool backward)
{
    tbb::parallel_for(std::size_t(0), rods.start.size() - 1, [&](std::size_t s) {
        const std::size_t low = rods.start[s], count = rods.start[s + 1] - low;
        const float rest = rods.length[s] / static_cast<float>(count);
        for (std::size_t k = 0; k < count; ++k) {
            const std::size_t i = backward ? count - 1 - k : k;
            glm::vec3 &a = rods.point[low + i], &b = rods.point[low + (i + 1 == count ? 0 : i + 1)];
            glm::vec3 d = b - a;
            if (i + 1 == count) d.x += rods.period.x;
            const float length = std::max(glm::length(d), 1e-6f);
            const glm::vec3 step = 0.5f * (1 - rest / length) * d;
            a += step;
            b -= step;
        }
    });
}

void part(Rods& rods, const Neighbours& neighbours, float distance)
{
    neighbours.each([&](const Pair& pair) {
        const glm::vec3 d = apart(rods, pair);
        const float square = glm::dot(d, d);
        if (square >= distance * distance) return;
        const float length = std::sqrt(std::max(square, 1e-8f));
        const glm::vec3 step = 0.5f * (distance / length - 1) * d;
        rods.point[pair.a] -= step;
        rods.point[pair.b] += step;
    });
}

// Squared distance of the segments p + s u and q + t v, s, t in [0, 1].
float segment_distance2(glm::vec3 p, glm::vec3 u, glm::vec3 q, glm::vec3 v)
{
    const glm::vec3 w = p - q;
    const float a = glm::dot(u, u), b = glm::dot(u, v), c = glm::dot(v, v), d = glm::dot(u, w), e = glm::dot(v, w);
    const float determinant = a * c - b * b;
    float s = determinant > 1e-9f * a * c ? std::clamp((b * e - c * d) / determinant, 0.0f, 1.0f) : 0.0f;
    const float t = std::clamp((b * s + e) / std::max(c, 1e-20f), 0.0f, 1.0f);
    s = std::clamp((b * t - d) / std::max(a, 1e-20f), 0.0f, 1.0f);
    const glm::vec3 gap = w + s * u - t * v;
    return glm::dot(gap, gap);
}

} // namespace

void relax(Rods& rods, float effort)
{
    const int growing = static_cast<int>(160 * effort), whole = static_cast<int>(120 * effort), settling = 12;
    constexpr float flattening = 0.01f; // a step: cloth is pressed and stretched, its loops do not stand up
    Neighbours neighbours(rods);
    std::vector<glm::vec3> before, listed;
    float reach = 0; // of the pairs that are listed
    // At last lengths are let go, a little: else what is too long for its place would zigzag from point to point.
    for (int step = 0; step < growing + whole + settling; ++step) {
        // Thin rods first: what lies on the wrong side at full thickness still finds its way.
        const float grown = std::min(1.0f, 0.5f + 0.5f * static_cast<float>(step) / static_cast<float>(growing));
        const bool bends = step < growing + whole;
        float moved2 = 0;
        for (std::size_t i = 0; i < listed.size(); ++i) {
            const glm::vec3 d = rods.point[i] - listed[i];
            moved2 = std::max(moved2, glm::dot(d, d));
        }
        if (2 * grown + 2 * std::sqrt(moved2) > reach) {
            reach = 2 * grown + margin;
            neighbours.find(rods, reach);
            listed = rods.point;
        }
        if (bends) {
            straighten(rods, before, 4, 0.12f);
            straighten(rods, before, 2, 0.25f);
        }
        straighten(rods, before, 1, 0.4f);
        if (bends)
            for (glm::vec3& p : rods.point) p.z *= 1 - flattening;
        for (int again = 0; again < 2; ++again) {
            if (bends) keep_lengths(rods, again == 1);
            part(rods, neighbours, 2 * grown);
        }
    }
}

std::vector<float> clearances(const Rods& rods)
{
    std::vector<float> clear(rods.point.size(), 1.0f);
    Neighbours neighbours(rods);
    neighbours.find(rods, 3.2f); // points this near can belong to segments that touch
    const auto onward = [&](std::size_t i) {
        const std::size_t s = neighbours.strand[i];
        const bool closes = i + 1 == rods.start[s + 1];
        glm::vec3 d = rods.point[closes ? rods.start[s] : i + 1] - rods.point[i];
        if (closes) d.x += rods.period.x;
        return d;
    };
    neighbours.each([&](const Pair& pair) {
        const glm::vec3 between = apart(rods, pair);
        const float half = 0.5f * std::sqrt(segment_distance2(glm::vec3(0), onward(pair.a), between, onward(pair.b)));
        for (const std::size_t i : {pair.a, pair.b}) {
            const std::size_t s = neighbours.strand[i], next = i + 1 == rods.start[s + 1] ? rods.start[s] : i + 1;
            clear[i] = std::min(clear[i], half);
            clear[next] = std::min(clear[next], half);
        }
    });
    return clear;
}

} // namespace selvedge
