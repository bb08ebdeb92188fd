// bake/maps.cpp: the exact tube projector and its filter.
#include "maps.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>

#include "pack.hpp"

namespace selvedge
{

namespace
{

constexpr float pi = 3.14159265358979f;
constexpr int band_rows = 8;               // texel rows that one task projects
constexpr float no_limit_m = 1.0f;         // higher than any cloth
constexpr float trusted_correction = 0.2f; // radii by which a smooth tube may differ from its chord
constexpr std::uint32_t no_segment = ~std::uint32_t(0);

int wrapped(int i, int n)
{
    const int r = i % n;
    return r < 0 ? r + n : r;
}

// All points of all tubes in the space where the sections are round (z over aspect).
struct Segments {
    std::vector<glm::vec4> point;   // xyz, w radius; point i and i + 1 are a segment unless `last` is set for i
    std::vector<glm::vec3> mitre;   // unit normal of the plane in which the segments before and after i meet
    std::vector<std::uint8_t> last; // the tube ends here
    std::vector<float> aspect;      // of the tube
    std::vector<glm::vec2> flat;    // of the tube: drawn out by so much to either side
    std::vector<std::uint8_t> yarn;
    std::vector<std::uint32_t> thread;
    std::vector<glm::ivec2> period; // of the thread: repeats from one end of its tubes to the other

    explicit Segments(const PlyModel& model)
    {
        for (const PlyTube& tube : model.tubes) {
            const std::size_t count = tube.points.size();
            const glm::vec3 stretch(1, 1, 1 / tube.aspect);
            const glm::ivec2 repeats(
                glm::round(glm::vec2(tube.points.back().centre_m - tube.points.front().centre_m) / model.tile_m));
            const auto direction = [&](std::size_t i) {
                return glm::normalize((tube.points[i + 1].centre_m - tube.points[i].centre_m) * stretch);
            };
            for (std::size_t i = 0; i < count; ++i) {
                const glm::vec3 arrives = i > 0 ? direction(i - 1)
                                          : tube.before_m
                                              ? glm::normalize((tube.points[0].centre_m - *tube.before_m) * stretch)
                                              : direction(count - 2);
                const glm::vec3 leaves = i + 1 < count ? direction(i)
                                         : tube.after_m
                                             ? glm::normalize((*tube.after_m - tube.points[i].centre_m) * stretch)
                                             : direction(0);
                point.emplace_back(tube.points[i].centre_m * stretch, tube.points[i].radius_m);
                mitre.push_back(glm::normalize(arrives + leaves));
                last.push_back(i + 1 == count ? 1 : 0);
                aspect.push_back(tube.aspect);
                flat.push_back(tube.flat_m);
                yarn.push_back(static_cast<std::uint8_t>(tube.yarn));
                thread.push_back(static_cast<std::uint32_t>(tube.thread));
                period.push_back(repeats);
            }
        }
    }
};

// Bounds in x and y of segment i: of the discs in its two mitre planes.
struct Bounds {
    glm::vec2 low, high;
};
Bounds bounds_of(const Segments& segments, std::size_t i)
{
    Bounds bounds{glm::vec2(std::numeric_limits<float>::max()), glm::vec2(std::numeric_limits<float>::lowest())};
    for (const std::size_t end : {i, i + 1}) {
        const glm::vec3 m = segments.mitre[end];
        const glm::vec2 centre(segments.point[end]);
        // 1.1: the mitre's ellipse is larger than the section where the tube bends
        const glm::vec2 reach =
            1.1f * segments.point[end].w * glm::sqrt(glm::max(1.0f - glm::vec2(m) * glm::vec2(m), 0.0f)) +
            glm::abs(segments.flat[end]);
        bounds.low = glm::min(bounds.low, centre - reach);
        bounds.high = glm::max(bounds.high, centre + reach);
    }
    return bounds;
}

// Which segments touch which band of rows: for each band a run of (segment, vertical shift by -1, 0, 1 tiles).
struct Bins {
    struct Item {
        std::uint32_t segment;
        std::int32_t shift;
    };
    std::vector<std::size_t> start; // bands + 1
    std::vector<Item> items;
};

Bins bin_segments(const Segments& segments, float tile_height, float row_m, int rows, int rows_per_band)
{
    const int bands = (rows + rows_per_band - 1) / rows_per_band;
    Bins bins;
    bins.start.assign(static_cast<std::size_t>(bands) + 1, 0);
    const auto visit = [&](auto&& put) {
        for (std::size_t i = 0; i + 1 < segments.point.size(); ++i) {
            if (segments.last[i]) continue;
            const Bounds b = bounds_of(segments, i);
            for (int shift = -1; shift <= 1; ++shift) {
                const float offset = static_cast<float>(shift) * tile_height;
                const float low = std::floor((b.low.y + offset) / row_m), high = std::ceil((b.high.y + offset) / row_m);
                if (high < 0 || low > static_cast<float>(rows)) continue;
                const int first = std::max(0, static_cast<int>(low)) / rows_per_band;
                const int final = std::min(rows - 1, static_cast<int>(high)) / rows_per_band;
                for (int band = first; band <= final; ++band)
                    put(static_cast<std::size_t>(band), Bins::Item{static_cast<std::uint32_t>(i), shift});
            }
        }
    };
    visit([&](std::size_t band, Bins::Item) { ++bins.start[band + 1]; });
    for (std::size_t band = 0; band < static_cast<std::size_t>(bands); ++band) bins.start[band + 1] += bins.start[band];
    bins.items.resize(bins.start.back());
    std::vector<std::size_t> at(bins.start.begin(), bins.start.end() - 1);
    visit([&](std::size_t band, Bins::Item item) { bins.items[at[band]++] = item; });
    return bins;
}

// z-buffers of a band of sample rows, both sides.
struct Band {
    int columns = 0, first_row = 0, rows = 0;
    std::vector<float> z[2];               // front: highest; back: lowest, negated
    std::vector<std::uint32_t> segment[2]; // no_segment in gaps
    std::vector<std::uint32_t> strand[2];  // whose it is: thread and lane, one number for each yarn in the cloth
    std::vector<glm::vec2> doubled[2];     // unit vector at twice the azimuth of the ply's centre line: t and -t agree

    void reset(int width, int first, int count)
    {
        columns = width, first_row = first, rows = count;
        const std::size_t size = static_cast<std::size_t>(width) * static_cast<std::size_t>(count);
        for (int side = 0; side < 2; ++side) {
            z[side].assign(size, std::numeric_limits<float>::lowest());
            segment[side].assign(size, no_segment);
            strand[side].resize(size);
            doubled[side].resize(size);
        }
    }
    std::size_t at(int column, int row) const
    {
        return static_cast<std::size_t>(row - first_row) * static_cast<std::size_t>(columns) +
               static_cast<std::size_t>(column);
    }
};

// What rays along z meet of the tube between two points: the straight cylinder about the chord tells where along the
// tube the ray meets it; there the cylinder about the smooth centre line (Hermite through the points, along the mitre
// normals) replaces it. Else the chords would show as facets.
struct TubePiece {
    glm::vec3 chord, d, m0, m1; // from point i to i + 1, unit along it, mitre normals
    float length, radius, overlap, inverse_a;
};

// A ray at x, y from point i and the straight cylinder: |p - (p.d) d|^2 = r^2 for p = (x, y, z) is
// a z^2 - 2 h z + c = 0.
struct Meeting {
    float inside;     // less than 0: it passes by
    float z;          // where it meets the upper surface (sign 1) or the lower one (-1)
    float past, left; // of that point: beyond the plane where the piece begins, before the plane where it ends
};
inline Meeting meet_straight(const TubePiece& piece, float x, float y, float sign)
{
    const auto& [chord, d, m0, m1, length, radius, overlap, inverse_a] = piece;
    const float along = x * d.x + y * d.y, h = along * d.z, a = 1 / inverse_a;
    const float inside = h * h - a * (x * x + y * y - along * along - radius * radius);
    const float z = (h + sign * std::sqrt(std::max(inside, 0.0f))) * inverse_a;
    return {inside, z, x * m0.x + y * m0.y + z * m0.z,
            (chord.x - x) * m1.x + (chord.y - y) * m1.y + (chord.z - z) * m1.z};
}

// Rays at qx, qy from point i, many at once and without a branch, so that the compiler makes vectors of the loop.
//   sign     1: the upper surface, -1: the lower one
//   height   sign * z from point i; -infinity where the ray meets nothing
//   doubled  as Band has it
void meet(const TubePiece& of, const float* __restrict qx, const float* __restrict qy, int count, float sign,
          float* __restrict height, float* __restrict doubled_x, float* __restrict doubled_y)
{
    const TubePiece piece = of; // a copy, which the loop's stores leave alone
    const auto& [chord, d, m0, m1, length, radius, overlap, inverse_a] = piece;
    for (int k = 0; k < count; ++k) {
        const float x = qx[k], y = qy[k];
        // Between the planes: not before the first, before the second; with a little overlap, for where radii change
        // the cylinders do not quite meet.
        const auto [inside, z, past, left] = meet_straight(piece, x, y, sign);
        const float whole = past + left, ratio = past / std::max(whole, 1e-20f);
        const float t = std::min(std::max(ratio, 0.0f), 1.0f), u = 1 - t;
        const float wx = u * m0.x + t * m1.x, wy = u * m0.y + t * m1.y, wz = u * m0.z + t * m1.z;
        const float wxy = wx * wx + wy * wy, scale = 1 / std::sqrt(wxy + wz * wz);
        const float vx = wx * scale, vy = wy * scale, vz = wz * scale;
        const float bow = t * t * (3 - 2 * t), bend = length * t * u;
        const float sx = x - bow * chord.x - bend * (u * m0.x - t * m1.x),
                    sy = y - bow * chord.y - bend * (u * m0.y - t * m1.y),
                    sz = bow * chord.z + bend * (u * m0.z - t * m1.z);
        const float a2 = 1 - vz * vz, along2 = sx * vx + sy * vy, h2 = along2 * vz;
        const float inside2 = h2 * h2 - a2 * (sx * sx + sy * sy - along2 * along2 - radius * radius);
        const float smooth = sz + (h2 + sign * std::sqrt(std::max(inside2, 0.0f))) / a2;
        // Where a ply bends within its own radius the two have nothing to do with each other.
        const bool trusted = (inside2 >= 0) & (std::abs(smooth - z) < trusted_correction * radius);
        const bool hit = (inside >= 0) & (past >= -overlap) & (left >= -overlap);
        height[k] = hit ? sign * (trusted ? smooth : z) : -std::numeric_limits<float>::infinity();
        const float over = 1 / std::max(wxy, 1e-30f);
        doubled_x[k] = (wx * wx - wy * wy) * over;
        doubled_y[k] = 2 * wx * wy * over;
    }
}

// A piece of a tube that is drawn out along `flat`: of its copies, moved by -flat to flat, a ray along z sees the
// highest. Those rise towards the one whose ridge the ray meets, where the normal has no part along `flat`, and fall
// beyond it.
struct Drawing {
    glm::vec2 along{0}; // of the copies, unit
    float reach = 0;    // to either side
    glm::vec2 axis{0};  // of the cylinder, in the plane, so long that along x axis = 1
    float ridge = 0;    // in front, in copies' distance from the axis; behind it is -ridge

    Drawing(glm::vec2 flat, const TubePiece& piece)
    {
        const float length = glm::length(flat);
        if (length == 0) return;
        along = flat / length;
        const float turn = cross(along, glm::vec2(piece.d));
        // Along itself: the copies cover nothing that the tube's other segments do not.
        if (std::abs(turn) < 1e-3f) return;
        reach = length;
        axis = glm::vec2(piece.d) / turn;
        const glm::vec3 normal = glm::normalize(glm::cross(piece.d, glm::vec3(along, 0)));
        ridge = piece.radius * (normal.z < 0 ? -1.0f : 1.0f) * cross(glm::vec2(normal), axis);
    }

    // The ray at q from point i of the tube, seen from point i of the copy that it sees.
    glm::vec2 moved(glm::vec2 q, const TubePiece& piece, float sign) const
    {
        float copy = std::clamp(cross(q, axis) - sign * ridge, -reach, reach);
        // Where that copy is met beyond the piece's end, the highest one within it is met at the end: Newton's steps
        // to there.
        for (int step = 0; step < 4; ++step) {
            const glm::vec2 p = q - copy * along;
            const Meeting met = meet_straight(piece, p.x, p.y, sign);
            const bool early = met.past < met.left;
            const float beyond = early ? met.past : met.left;
            if (met.inside < 0 || beyond >= -piece.overlap) break;
            const glm::vec3 point(p, met.z), normal = point - glm::dot(point, piece.d) * piece.d;
            const glm::vec3 moves(-along, glm::dot(glm::vec2(normal), along) / normal.z);
            const float slope = early ? glm::dot(piece.m0, moves) : -glm::dot(piece.m1, moves);
            const float next = std::clamp(copy - beyond / slope, -reach, reach);
            if (!(std::abs(next - copy) > 1e-4f * piece.radius)) break;
            copy = next;
        }
        return q - copy * along;
    }

  private:
    static float cross(glm::vec2 a, glm::vec2 b) { return a.x * b.y - a.y * b.x; }
};

// Rays along z against the tube between points i and i + 1.
//   shift  repeats along y by which it is moved
void rasterise(const Segments& segments, std::size_t i, int shift, float tile_height, glm::vec2 step_m, Band& band)
{
    const float shift_m = static_cast<float>(shift) * tile_height;
    Bounds b = bounds_of(segments, i);
    b.low.y += shift_m, b.high.y += shift_m;
    const int row0 = std::max(band.first_row, static_cast<int>(std::ceil(b.low.y / step_m.y - 0.5f)));
    const int row1 = std::min(band.first_row + band.rows - 1, static_cast<int>(std::floor(b.high.y / step_m.y - 0.5f)));
    const glm::vec3 from(segments.point[i]), chord = glm::vec3(segments.point[i + 1]) - from;
    const float length = glm::length(chord);
    const glm::vec3 d = chord / length;
    const float radius = 0.5f * (segments.point[i].w + segments.point[i + 1].w), aspect = segments.aspect[i],
                overlap = 0.02f * radius;
    const glm::vec3 m0 = segments.mitre[i], m1 = segments.mitre[i + 1];
    // Upright: seen as nothing but its neighbours' ends. Folded back on itself: inside the bend of its neighbours.
    if (1 - d.z * d.z < 1e-6f || glm::dot(m0, d) < 0.1f || glm::dot(m1, d) < 0.1f) return;
    const TubePiece piece{chord, d, m0, m1, length, radius, overlap, 1 / (1 - d.z * d.z)};
    const Drawing drawing(segments.flat[i], piece);
    const glm::vec2 drawn = drawing.reach * drawing.along;

    constexpr int rays = 64;
    float qx[rays], qy[rays], height[rays], doubled_x[rays], doubled_y[rays];
    std::uint32_t cell[rays], strand[rays];
    int count = 0;
    const float a = 1 - d.z * d.z, across = std::sqrt(a), slack = overlap + 1e-4f * radius;
    for (int side = 0; side < 2; ++side) {
        const float sign = side == 0 ? 1.0f : -1.0f, base = sign * from.z;
        const auto flush = [&] {
            meet(piece, qx, qy, count, sign, height, doubled_x, doubled_y);
            for (int k = 0; k < count; ++k) {
                const float z = aspect * (height[k] + base);
                if (!(z > band.z[side][cell[k]])) continue;
                band.z[side][cell[k]] = z;
                band.segment[side][cell[k]] = static_cast<std::uint32_t>(i);
                band.strand[side][cell[k]] = strand[k];
                band.doubled[side][cell[k]] = {doubled_x[k], doubled_y[k]};
            }
            count = 0;
        };
        // z = h / a + sign * root / a with h linear in x and y and root / a from 0 to radius / across: what `meet` asks
        // of a hit, c x >= low, at the root and the copy that ask least.
        const glm::vec2 rise = glm::vec2(d) * (d.z / a);
        const glm::vec2 c0 = glm::vec2(m0) + m0.z * rise, c1 = glm::vec2(m1) + m1.z * rise;
        const float low0 = -slack - std::max(sign * m0.z, 0.0f) * radius / across,
                    low1 = -slack - std::max(-sign * m1.z, 0.0f) * radius / across - glm::dot(chord, m1);
        for (int row = row0; row <= row1; ++row) {
            const float y = (static_cast<float>(row) + 0.5f) * step_m.y - shift_m - from.y;
            float least = b.low.x - from.x, most = b.high.x - from.x;
            const auto bound = [&](glm::vec2 c2, float low2) {
                const float c = c2.x, low = low2 - y * c2.y - std::abs(glm::dot(c2, drawn));
                if (c > 1e-6f) least = std::max(least, low / c);
                if (c < -1e-6f) most = std::min(most, low / c);
                if (std::abs(c) <= 1e-6f && low > slack) most = least - step_m.x;
            };
            bound(c0, low0);
            bound(-c1, low1);
            bound({d.y, -d.x}, -radius * across - slack);
            bound({-d.y, d.x}, -radius * across - slack);
            const int column0 = static_cast<int>(std::ceil((least + from.x) / step_m.x - 0.5f));
            const int column1 = static_cast<int>(std::floor((most + from.x) / step_m.x - 0.5f));
            const auto row_cell = static_cast<std::uint32_t>(band.at(0, row));
            const auto columns = static_cast<std::uint32_t>(band.columns);
            auto wrapped_column = static_cast<std::uint32_t>(wrapped(column0, band.columns));
            // The repeat of the cloth whose tube is met in this tile. A thread goes on from repeat to repeat along its
            // period; on another lane lies another yarn.
            glm::ivec2 repeat((static_cast<int>(wrapped_column) - column0) / band.columns, shift);
            const glm::ivec2 period = segments.period[i];
            for (int column = column0; column <= column1;) {
                const int run = std::min(column1 - column + 1, rays - count);
                for (int k = 0; k < run; ++k) {
                    qx[count + k] = (static_cast<float>(column + k) + 0.5f) * step_m.x - from.x;
                    qy[count + k] = y;
                }
                for (int k = count; drawing.reach > 0 && k < count + run; ++k) {
                    const glm::vec2 moved = drawing.moved({qx[k], qy[k]}, piece, sign);
                    qx[k] = moved.x, qy[k] = moved.y;
                }
                for (int k = 0; k < run; ++k) {
                    cell[count + k] = row_cell + wrapped_column;
                    const int lane = repeat.x * period.y - repeat.y * period.x;
                    strand[count + k] = (segments.thread[i] << 8) + (static_cast<std::uint32_t>(lane) & 0xffu);
                    if (++wrapped_column == columns) {
                        wrapped_column = 0;
                        --repeat.x;
                    }
                }
                column += run;
                count += run;
                if (count == rays) flush();
            }
        }
        flush();
    }
}

// One texel out of samples x samples rays.
void filter_texel(const Segments& segments, const Band& band, int x, int y, int samples, FabricMaps& maps)
{
    constexpr int most_kinds = 16; // samples of a texel: at most 4 x 4
    const std::size_t texel =
        static_cast<std::size_t>(y) * static_cast<std::size_t>(maps.size.x) + static_cast<std::size_t>(x);
    const int x0 = x * samples, y0 = y * samples, total = samples * samples;
    bool gap = false;
    int two = 0; // samples that meet two yarns
    for (int side = 0; side < 2; ++side) {
        float sum = 0;
        // The yarn that most samples see; the mean of its segments' directions.
        std::uint8_t yarn[most_kinds];
        int votes[most_kinds];
        glm::vec2 doubled[most_kinds];
        int kinds = 0, covered = 0;
        for (int row = y0; row < y0 + samples; ++row)
            for (int column = x0; column < x0 + samples; ++column) {
                const std::size_t cell = band.at(column, row);
                const std::uint32_t s = band.segment[side][cell];
                if (s == no_segment) continue;
                ++covered;
                sum += band.z[side][cell];
                if (side == 0 && band.strand[0][cell] != band.strand[1][cell]) ++two;
                int kind = 0;
                while (kind < kinds && yarn[kind] != segments.yarn[s]) ++kind;
                if (kind == kinds) {
                    yarn[kind] = segments.yarn[s];
                    votes[kind] = 0;
                    doubled[kind] = glm::vec2(0);
                    ++kinds;
                }
                doubled[kind] += band.doubled[side][cell];
                ++votes[kind];
            }
        if (side == 0) {
            gap = 2 * covered <= total;
            maps.stacked[texel] = !gap && 2 * two > covered ? 1 : 0;
        }
        maps.gap[texel] = gap ? 1 : 0;
        maps.side[side].height_m[texel] = gap ? 0.0f : sum / static_cast<float>(total);
        if (kinds == 0) continue; // fill_gaps says whose it is
        const auto best = std::max_element(votes, votes + kinds) - votes;
        float azimuth = 0.5f * std::atan2(doubled[best].y, doubled[best].x);
        azimuth = azimuth < 0 ? azimuth + pi : azimuth;
        maps.side[side].azimuth[texel] = azimuth >= pi ? 0 : azimuth;
        maps.side[side].yarn[texel] = yarn[best];
    }
}

// Gap texels take yarn and azimuth of the nearest texel that has a yarn: jump flooding on the periodic grid.
void fill_gaps(FabricMaps& maps)
{
    const int w = maps.size.x, h = maps.size.y;
    const auto index = [&](int x, int y) {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x);
    };
    const glm::vec2 texel_m = maps.tile_m / glm::vec2(maps.size);
    if (std::find(maps.gap.begin(), maps.gap.end(), 1) == maps.gap.end() ||
        std::find(maps.gap.begin(), maps.gap.end(), 0) == maps.gap.end())
        return;
    constexpr int none = std::numeric_limits<int>::max();
    std::vector<glm::ivec2> seed(maps.gap.size(), glm::ivec2(none)), next; // offset to the source
    for (std::size_t i = 0; i < seed.size(); ++i)
        if (!maps.gap[i]) seed[i] = glm::ivec2(0);
    int jump = 1;
    while (jump < std::max(w, h)) jump *= 2;
    for (; jump >= 1; jump /= 2) {
        next = seed;
        tbb::parallel_for(0, h, [&](int y) {
            for (int x = 0; x < w; ++x) {
                const std::size_t here = index(x, y);
                if (!maps.gap[here]) continue;
                const auto distance = [&](glm::ivec2 offset) {
                    const glm::vec2 m = glm::vec2(offset) * texel_m;
                    return glm::dot(m, m);
                };
                float best = next[here].x == none ? std::numeric_limits<float>::max() : distance(next[here]);
                for (int dy = -jump; dy <= jump; dy += jump)
                    for (int dx = -jump; dx <= jump; dx += jump) {
                        const glm::ivec2 theirs = seed[index(wrapped(x + dx, w), wrapped(y + dy, h))];
                        if (theirs.x == none) continue;
                        const glm::ivec2 offset = theirs + glm::ivec2(dx, dy);
                        if (const float d = distance(offset); d < best) {
                            best = d;
                            next[here] = offset;
                        }
                    }
            }
        });
        seed.swap(next);
    }
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x)
            if (const std::size_t here = index(x, y); maps.gap[here] && seed[here].x != none) {
                const std::size_t source = index(wrapped(x + seed[here].x, w), wrapped(y + seed[here].y, h));
                for (SideMaps& side : maps.side) {
                    side.yarn[here] = side.yarn[source];
                    side.azimuth[here] = side.azimuth[source];
                }
            }
}

// Lowest function above f that falls by no more than `fall` a metre, in any direction: f spread along cones. Chamfer
// sweeps over the periodic grid with king's and knight's moves (distances up to 2.8 % long), until nothing changes.
void spread_cones(std::vector<float>& f, glm::ivec2 size, glm::vec2 texel_m, float fall)
{
    struct Move {
        int dx, dy;
        float cost;
    };
    std::vector<Move> moves; // to texels that a sweep from the lowest row up has already seen
    for (const glm::ivec2 m : {glm::ivec2(-1, 0), {-2, -1}, {-1, -1}, {0, -1}, {1, -1}, {2, -1}, {-1, -2}, {1, -2}})
        moves.push_back({m.x, m.y, fall * glm::length(glm::vec2(m) * texel_m)});
    constexpr int most_laps = 4;
    for (int lap = 0; lap < most_laps; ++lap) {
        bool changed = false;
        for (const int way : {1, -1})
            for (int j = 0; j < size.y; ++j) {
                const int y = way > 0 ? j : size.y - 1 - j;
                const float* rows[3]; // this one and the two before it
                for (int r = 0; r < 3; ++r) rows[r] = f.data() + std::ptrdiff_t(wrapped(y - way * r, size.y)) * size.x;
                float* here = f.data() + std::ptrdiff_t(y) * size.x;
                for (int i = 0; i < size.x; ++i) {
                    const int x = way > 0 ? i : size.x - 1 - i;
                    const bool inside = x >= 2 && x < size.x - 2;
                    float best = here[x];
                    for (const Move& move : moves) {
                        const int from = x + way * move.dx;
                        best = std::max(best, rows[-move.dy][inside ? from : wrapped(from, size.x)] - move.cost);
                    }
                    changed = changed || best > here[x];
                    here[x] = best;
                }
            }
        if (!changed) break;
    }
}

// 1 2 1 along x and along y, periodic.
std::vector<float> binomial_blur(const std::vector<float>& f, glm::ivec2 size)
{
    std::vector<float> across(f.size()), out(f.size());
    tbb::parallel_for(0, size.y, [&](int y) {
        const float* row = f.data() + std::ptrdiff_t(y) * size.x;
        for (int x = 0; x < size.x; ++x)
            across[static_cast<std::size_t>(std::ptrdiff_t(y) * size.x + x)] =
                0.25f * (row[wrapped(x - 1, size.x)] + row[wrapped(x + 1, size.x)]) + 0.5f * row[x];
    });
    tbb::parallel_for(0, size.y, [&](int y) {
        const auto row = [&](int r) { return across.data() + std::ptrdiff_t(wrapped(r, size.y)) * size.x; };
        const float *here = row(y), *low = row(y - 1), *high = row(y + 1);
        for (int x = 0; x < size.x; ++x)
            out[static_cast<std::size_t>(std::ptrdiff_t(y) * size.x + x)] = 0.25f * (low[x] + high[x]) + 0.5f * here[x];
    });
    return out;
}

// Yarns end in walls, and slopes are stored up to slope_limit: light and eye would miss the walls' area (E[A_p] of
// math.md 6.2 falls to .88 at 60 deg). So the field itself is made no steeper: each wall becomes a ramp, between
// the steepest fields above and below it (PlyModel::wall_share). Gaps stay at 0, so ramps to them lie on the yarn.
void limit_slopes(FabricMaps& maps, SideMaps& side, float wall_share, float gap_fall)
{
    const glm::vec2 texel_m = maps.tile_m / glm::vec2(maps.size);
    std::vector<float> above = side.height_m, below = side.height_m, reach(above.size());
    for (std::size_t i = 0; i < above.size(); ++i) {
        below[i] = -below[i];
        reach[i] = maps.gap[i] ? 0.0f : -no_limit_m; // -(greatest height so near a gap)
    }
    tbb::parallel_invoke([&] { spread_cones(above, maps.size, texel_m, slope_limit); },
                         [&] { spread_cones(below, maps.size, texel_m, slope_limit); },
                         [&] { spread_cones(reach, maps.size, texel_m, gap_fall); });
    const std::vector<float> before = side.height_m;
    for (std::size_t i = 0; i < above.size(); ++i) above[i] = glm::mix(-below[i], above[i], wall_share);
    // Cones from texels make ragged ramps: smoothed there, and only there.
    below = above;
    std::vector<float> smooth_reach = reach;
    for (int pass = 0; pass < 2; ++pass) {
        below = binomial_blur(below, maps.size);
        smooth_reach = binomial_blur(smooth_reach, maps.size);
    }
    const float full = 0.25f * slope_limit * std::min(texel_m.x, texel_m.y);
    for (std::size_t i = 0; i < above.size(); ++i) {
        const float share = std::min(std::abs(above[i] - before[i]) / full, 1.0f);
        const float limit = -std::max(reach[i], smooth_reach[i]);
        side.height_m[i] = maps.gap[i] ? 0.0f : std::clamp(glm::mix(above[i], below[i], share), -limit, limit);
    }
}

// Central differences, periodic.
void difference_slopes(FabricMaps& maps, SideMaps& side)
{
    const int w = maps.size.x, h = maps.size.y;
    const glm::vec2 scale = 0.5f * glm::vec2(maps.size) / maps.tile_m;
    tbb::parallel_for(0, h, [&](int y) {
        const auto row = [&](int r) { return side.height_m.data() + std::ptrdiff_t(wrapped(r, h)) * w; };
        const float *here = row(y), *before = row(y - 1), *after = row(y + 1);
        for (int x = 0; x < w; ++x)
            side.slope[static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x)] = {
                (here[wrapped(x + 1, w)] - here[wrapped(x - 1, w)]) * scale.x, (after[x] - before[x]) * scale.y};
    });
}

} // namespace

int samples_for(glm::ivec2 size)
{
    const int side = std::max(size.x, size.y);
    return side <= 512 ? 4 : side <= 1024 ? 3 : 2;
}

FabricMaps project_plies(const PlyModel& model, glm::ivec2 size, int samples)
{
    FabricMaps maps;
    maps.size = size;
    maps.tile_m = model.tile_m;
    const std::size_t count = static_cast<std::size_t>(size.x) * static_cast<std::size_t>(size.y);
    for (SideMaps& side : maps.side) {
        side.height_m.assign(count, 0);
        side.slope.assign(count, glm::vec2(0));
        side.azimuth.assign(count, 0);
        side.yarn.assign(count, 0);
    }
    maps.gap.assign(count, 1);
    maps.stacked.assign(count, 0);

    const Segments segments(model);
    const glm::vec2 step_m = model.tile_m / glm::vec2(size) / static_cast<float>(samples);
    const int rows = size.y * samples;
    const Bins bins = bin_segments(segments, model.tile_m.y, step_m.y, rows, band_rows * samples);
    tbb::parallel_for(std::size_t(0), bins.start.size() - 1, [&](std::size_t b) {
        thread_local Band band;
        const int y0 = static_cast<int>(b) * band_rows, y1 = std::min(y0 + band_rows, size.y);
        band.reset(size.x * samples, y0 * samples, (y1 - y0) * samples);
        for (std::size_t k = bins.start[b]; k < bins.start[b + 1]; ++k)
            rasterise(segments, bins.items[k].segment, bins.items[k].shift, model.tile_m.y, step_m, band);
        for (int y = y0; y < y1; ++y)
            for (int x = 0; x < size.x; ++x) filter_texel(segments, band, x, y, samples, maps);
    });
    fill_gaps(maps);
    tbb::parallel_for(0, 2, [&](int s) {
        limit_slopes(maps, maps.side[s], model.wall_share, slope_limit * model.gap_steepness);
        difference_slopes(maps, maps.side[s]);
    });
    return maps;
}

std::vector<glm::vec2> slope_mips(const std::vector<glm::vec2>& slope, glm::ivec2 size)
{
    std::vector<glm::vec2> out, above = slope;
    // Level 0 cells under one cell of the next level, with the shares of their length that lie in it.
    struct Tap {
        int cell;
        float weight;
    };
    const auto taps = [](int i, int from, int to) {
        std::vector<Tap> list;
        const double low = static_cast<double>(i) * from / to, high = static_cast<double>(i + 1) * from / to;
        for (int c = static_cast<int>(low); c < from && static_cast<double>(c) < high - 1e-9; ++c)
            list.push_back({c, static_cast<float>((std::min(high, c + 1.0) - std::max(low, static_cast<double>(c))) /
                                                  (high - low))});
        return list;
    };
    for (int level = 1; level < slope_level_count(size); ++level) {
        const glm::ivec2 from = slope_level_size(size, level - 1), to = slope_level_size(size, level);
        std::vector<glm::vec2> here(static_cast<std::size_t>(to.x) * static_cast<std::size_t>(to.y));
        std::vector<std::vector<Tap>> columns;
        for (int x = 0; x < to.x; ++x) columns.push_back(taps(x, from.x, to.x));
        for (int y = 0; y < to.y; ++y)
            for (const Tap& row : taps(y, from.y, to.y))
                for (int x = 0; x < to.x; ++x)
                    for (const Tap& column : columns[static_cast<std::size_t>(x)])
                        here[static_cast<std::size_t>(y * to.x + x)] +=
                            row.weight * column.weight *
                            above[static_cast<std::size_t>(row.cell * from.x + column.cell)];
        out.insert(out.end(), here.begin(), here.end());
        above.swap(here);
    }
    return out;
}

} // namespace selvedge
