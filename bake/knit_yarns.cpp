// bake/knit_yarns.cpp: loops laid out, relaxed, and repeated over the tile.
#include "knit_yarns.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "error.hpp"
#include "knit_relax.hpp"

namespace selvedge
{

namespace
{

constexpr float pi = 3.14159265358979f;
constexpr float narrowest_period = 5.4f; // of what is relaxed, in radii: pairs see one image of each other
constexpr int fewest_loops = 4;          // of a tile each way: room for a turn of the plies
constexpr float widest_share = 0.46f;    // of a wale that a yarn may take: two legs pass each other in each wale
constexpr float highest_share = 0.62f;   // and of a course
// Start of the relaxation, in radii of the yarn.
constexpr float depth = 1.6f;      // d of Crane's curve
constexpr float lean = 0.21f;      // a of Crane's curve, in wales
constexpr float level_step = 2.4f; // between strands that cross, heads that are drawn together, floats
constexpr float bed_depth = 2.6f;  // of a bed from the middle
constexpr float fine_spacing = 0.55f, coarse_spacing = 0.8f; // of the rods' points; coarse where there are
constexpr std::size_t many_loops = 400;                      // many loops,
constexpr float many_loops_effort = 0.5f;                    // which are relaxed for a shorter time, too

float smooth(float low, float high, float x)
{
    const float t = std::clamp((x - low) / (high - low), 0.0f, 1.0f);
    return t * t * (3 - 2 * t);
}

// A loop as laid out, in radii; z over aspect.
struct Laid {
    glm::vec2 base, head;                   // middle of the feet; where its child's feet are
    float face, child_face;                 // 0 for a yarn over
    float bed, level, child_level, stacked; // z of bed, of the crossing at the feet and at the head, of shared heads
};

class Layout
{
  public:
    Layout(const KnitPattern& of, const KnitPlan& plan)
        : pattern(of), radius_m(plan.width_m / 2), wale(plan.wale_m / radius_m), row(plan.row_m / radius_m),
          loop_length(plan.loop_m / radius_m)
    {
        const std::vector<KnitParent> child = children(pattern);
        for (std::size_t i = 0; i < pattern.loops.size(); ++i) {
            const KnitLoop& loop = pattern.loops[i];
            const KnitLoop& after = pattern.loops[static_cast<std::size_t>(child[i].loop)];
            Laid laid;
            laid.base = {(static_cast<float>(loop.column) + 0.5f) * wale, static_cast<float>(loop.row) * row};
            laid.head = {(static_cast<float>(after.column + child[i].across * pattern.columns) + 0.5f) * wale,
                         static_cast<float>(after.row + child[i].up * pattern.rows) * row};
            laid.face = loop.parents.empty() ? 0 : static_cast<float>(loop.face);
            laid.child_face = static_cast<float>(after.face);
            laid.bed = bed_depth * static_cast<float>(loop.bed);
            is_double = is_double || loop.bed != 0;
            laid.level = level_step * static_cast<float>(loop.level);
            laid.child_level = level_step * static_cast<float>(after.level);
            float place = 0;
            for (std::size_t k = 0; k < after.parents.size(); ++k)
                if (after.parents[k].loop == static_cast<int>(i)) place = static_cast<float>(k);
            laid.stacked = level_step * (0.5f * static_cast<float>(after.parents.size() - 1) - place);
            loops.push_back(laid);
        }
        // How far heads reach beyond the feet of the next row: from the length of the loop.
        const float course = row * static_cast<float>(pattern.rows_per_course);
        const Laid plain{{0, 0}, {0, course}, 1, 1, 0, 0, 0, 0};
        float low = 0.05f * course, high = 2.0f * course;
        for (int step = 0; step < 24; ++step) {
            overlap = 0.5f * (low + high);
            float length = 0;
            glm::vec3 before = at(plain, 0, 1, 1);
            for (int k = 1; k <= 48; ++k) {
                const glm::vec3 here = at(plain, static_cast<float>(k) / 48, 1, 1);
                length += glm::length(here - before);
                before = here;
            }
            (length < loop_length ? low : high) = overlap;
        }
    }

    // Point of a loop, u from 0 (left foot) to 1 (right foot), with the faces of its neighbours along the yarn.
    glm::vec3 at(const Laid& loop, float u, float left_face, float right_face) const
    {
        const float t = 2 * pi * (u - 0.5f), far = std::abs(t);
        const float raised = 0.5f * (1 + std::cos(t));
        const float x = loop.base.x + wale * (u - 0.5f + lean * std::sin(2 * t)) +
                        (loop.head.x - loop.base.x) * smooth(0.1f, 0.9f, raised);
        const float y = loop.base.y + (loop.head.y - loop.base.y + overlap) * raised;
        float face = glm::mix(loop.child_face, loop.face, smooth(1.3f, 1.75f, far));
        face = glm::mix(face, 0.5f * (loop.face + (t < 0 ? left_face : right_face)), smooth(2.5f, pi, far));
        const float z = -depth * face * std::cos(2 * t) + glm::mix(loop.level, loop.child_level, raised) +
                        loop.stacked * smooth(0.5f, 1, raised);
        return {x, y, z};
    }

    // One strand of one row as a line that closes, and its length.
    void lay(const std::vector<std::size_t>& members, int order, std::vector<glm::vec3>& line, float& length) const
    {
        line.clear();
        length = 0;
        const float width = static_cast<float>(pattern.columns) * wale;
        for (std::size_t k = 0; k < members.size(); ++k) {
            const std::size_t last = members.size() - 1;
            const Laid& loop = loops[members[k]];
            const Laid& before = loops[members[k ? k - 1 : last]];
            const Laid& after = loops[members[k < last ? k + 1 : 0]];
            const float next_x = after.base.x + (k < last ? 0 : width);
            const float float_length = next_x - loop.base.x - wale;
            const bool floats = float_length > 0.5f * wale;
            const float left_bed = 0.5f * (before.bed + loop.bed), right_bed = 0.5f * (loop.bed + after.bed);
            for (int s = 0; s < 64; ++s) {
                const float u = static_cast<float>(s) / 64, far = std::abs(u - 0.5f);
                glm::vec3 p = at(loop, u, before.face, after.face);
                p.z += glm::mix(loop.bed, u < 0.5f ? left_bed : right_bed, smooth(0.4f, 0.5f, far));
                line.push_back(p);
            }
            if (floats) {
                const glm::vec3 from = at(loop, 1, before.face, after.face) + glm::vec3(0, 0, right_bed);
                const float to_z = from.z, middle = is_double ? 0 : -depth - level_step * static_cast<float>(1 + order);
                for (int s = 0; s < 32; ++s) {
                    const float v = static_cast<float>(s) / 32, edge = std::min(v, 1 - v) * float_length;
                    const float share = smooth(0, wale, edge);
                    line.push_back({from.x + v * float_length, loop.base.y + share * 0.8f * static_cast<float>(order),
                                    glm::mix(to_z, middle, share)});
                }
                length += float_length;
            }
            const glm::vec2 rise = loop.head - loop.base;
            const float course = row * static_cast<float>(pattern.rows_per_course);
            length += loop_length + 2 * std::max(glm::length(rise) - course, 0.0f) +
                      std::hypot(wale, right_bed == 0 ? loop.bed - after.bed : 0) - wale;
        }
    }

    const KnitPattern& pattern;
    float radius_m, wale, row, loop_length, overlap = 0;
    bool is_double = false; // both beds knit: floats run between them, else behind
    std::vector<Laid> loops;
};

// `count` points evenly spaced along a line that closes after `period`.
void resample(const std::vector<glm::vec3>& line, glm::vec3 period, std::size_t count, std::vector<glm::vec3>& out)
{
    std::vector<float> at(1, 0.0f);
    for (std::size_t i = 0; i < line.size(); ++i)
        at.push_back(at.back() + glm::length((i + 1 < line.size() ? line[i + 1] : line[0] + period) - line[i]));
    std::size_t i = 0;
    for (std::size_t k = 0; k < count; ++k) {
        const float s = at.back() * static_cast<float>(k) / static_cast<float>(count);
        while (i + 1 < line.size() && at[i + 1] <= s) ++i;
        const glm::vec3 next = i + 1 < line.size() ? line[i + 1] : line[0] + period;
        out.push_back(glm::mix(line[i], next, (s - at[i]) / std::max(at[i + 1] - at[i], 1e-6f)));
    }
}

// Catmull-Rom through p1 and p2.
glm::vec4 spline(const glm::vec4& p0, const glm::vec4& p1, const glm::vec4& p2, const glm::vec4& p3, float t)
{
    return p1 + 0.5f * t * (p2 - p0 + t * (2.0f * p0 - 5.0f * p1 + 4.0f * p2 - p3 + t * (3.0f * (p1 - p2) + p3 - p0)));
}

int even_up(float texels)
{
    return std::max(2, 2 * static_cast<int>(std::ceil(texels / 2 - 1e-3f)));
}

} // namespace

KnitPlan plan_knit(const Fabric& fabric, int resolution)
{
    KnitPlan plan;
    const YarnSpec& yarn = fabric.weft;
    KnitPattern pattern = smallest_repeat(*fabric.knit);
    plan.wale_m = fabric.wale_spacing_m;
    plan.row_m = fabric.course_spacing_m / static_cast<float>(pattern.rows_per_course);
    plan.width_m = yarn.width_m;
    const float widest = std::min(widest_share * plan.wale_m, highest_share * fabric.course_spacing_m);
    if (plan.width_m > widest * 1.0001f) {
        plan.warnings.push_back(format_text("yarn %.3g m wide in loops %.3g x %.3g m: narrowed to %.3g m",
                                            static_cast<double>(plan.width_m), static_cast<double>(plan.wale_m),
                                            static_cast<double>(fabric.course_spacing_m), static_cast<double>(widest)));
        plan.width_m = widest;
    }
    plan.loop_m = fabric.loop_length_m.value_or(2 * fabric.course_spacing_m + plan.wale_m + 5.94f * plan.width_m);

    const auto times = [](float have, float need) { return std::max(1, static_cast<int>(std::ceil(need / have))); };
    const float narrowest = narrowest_period * plan.width_m / 2;
    plan.pattern = repeated(
        pattern, times(static_cast<float>(pattern.columns) * plan.wale_m, std::max(narrowest, 1.5f * plan.wale_m)),
        times(static_cast<float>(pattern.rows) * plan.row_m, std::max(narrowest, 1.5f * fabric.course_spacing_m)));
    plan.across = times(static_cast<float>(plan.pattern.columns), fewest_loops);
    plan.up = times(static_cast<float>(plan.pattern.rows), fewest_loops * static_cast<float>(pattern.rows_per_course));
    plan.tile_m = {static_cast<float>(plan.pattern.columns * plan.across) * plan.wale_m,
                   static_cast<float>(plan.pattern.rows * plan.up) * plan.row_m};

    const float longer_m = std::max(plan.tile_m.x, plan.tile_m.y);
    const auto side_for = [&](float texels_across) { return longer_m / plan.width_m * texels_across; };
    float side = static_cast<float>(std::min(resolution, side_limit));
    if (side_for(texels_per_yarn) > side) {
        const float wished = std::min(side_for(texels_per_yarn), static_cast<float>(side_limit));
        if (side_for(1.5f) > static_cast<float>(side_limit))
            throw InputError(fabric.path.empty() ? fabric.name : fabric.path, 0,
                             "knitted repeat of %d x %d loops, %.3g x %.3g m, needs %.0f texels a side for 1.5 texels "
                             "across the yarn, expected at most %d",
                             plan.pattern.columns, plan.pattern.rows, static_cast<double>(plan.tile_m.x),
                             static_cast<double>(plan.tile_m.y), static_cast<double>(side_for(1.5f)), side_limit);
        plan.warnings.push_back(format_text("resolution raised from %d to %d: %.2g texels across the yarn (%d wished)",
                                            resolution, even_up(wished), static_cast<double>(wished / side_for(1)),
                                            texels_per_yarn));
        side = wished;
    }
    const float texel_m = longer_m / static_cast<float>(even_up(side));
    plan.size = {std::min(even_up(plan.tile_m.x / texel_m), side_limit),
                 std::min(even_up(plan.tile_m.y / texel_m), side_limit)};
    plan.plies = yarn.plies;
    if (plan.plies > 1 && plan.width_m / texel_m < fewest_texels_for_plies) {
        plan.warnings.push_back(format_text("yarns are %.2g texels wide: their %d plies are drawn as one",
                                            static_cast<double>(plan.width_m / texel_m), plan.plies));
        plan.plies = 1;
    }
    return plan;
}

std::vector<YarnPath> knit_yarns(const Fabric& fabric, const KnitPlan& plan, std::vector<std::string>& warnings)
{
    const KnitPattern& pattern = plan.pattern;
    const YarnSpec& yarn = fabric.weft;
    const Layout layout(pattern, plan);
    const float radius_m = plan.width_m / 2;
    const bool many = pattern.loops.size() > many_loops;
    const float spacing = many ? coarse_spacing : fine_spacing;

    // Strands: loops of one row and one yarn, from left to right.
    std::vector<std::size_t> order(pattern.loops.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    const auto key = [&](std::size_t i) {
        const KnitLoop& loop = pattern.loops[i];
        return std::make_tuple(loop.row, loop.strand, loop.column);
    };
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
    Rods rods;
    rods.period = glm::vec2(pattern.columns, pattern.rows) * glm::vec2(layout.wale, layout.row);
    rods.start.push_back(0);
    std::vector<int> strand_colour;
    std::vector<glm::vec3> line;
    for (std::size_t i = 0, in_row = 0; i < order.size(); ++in_row) {
        const KnitLoop& first = pattern.loops[order[i]];
        std::vector<std::size_t> members;
        for (; i < order.size() && pattern.loops[order[i]].row == first.row &&
               pattern.loops[order[i]].strand == first.strand;
             ++i)
            members.push_back(order[i]);
        if (!strand_colour.empty() && i > members.size() &&
            pattern.loops[order[i - members.size() - 1]].row != first.row)
            in_row = 0;
        float length = 0;
        layout.lay(members, static_cast<int>(in_row), line, length);
        const std::size_t count = std::max<std::size_t>(8, static_cast<std::size_t>(std::lround(length / spacing)));
        resample(line, {rods.period.x, 0, 0}, count, rods.point);
        rods.start.push_back(rods.point.size());
        rods.length.push_back(length);
        strand_colour.push_back(first.strand);
    }
    relax(rods, many ? many_loops_effort : 1);

    float lowest = 1e9f, highest = -1e9f;
    for (const glm::vec3& p : rods.point) lowest = std::min(lowest, p.z), highest = std::max(highest, p.z);
    for (glm::vec3& p : rods.point) p.z -= 0.5f * (lowest + highest);
    std::vector<float> clear = clearances(rods);
    const float tightest = *std::min_element(clear.begin(), clear.end());
    if (tightest < 0.9f)
        warnings.push_back(format_text("yarns press into each other: thinned to %.0f %% of their width where they do",
                                       100 * static_cast<double>(tightest)));

    // One path for each strand of each repeat upwards. Thinning comes and goes over some points.
    std::vector<YarnPath> yarns;
    const float texel_m =
        std::max(plan.tile_m.x / static_cast<float>(plan.size.x), plan.tile_m.y / static_cast<float>(plan.size.y));
    for (std::size_t s = 0; s + 1 < rods.start.size(); ++s) {
        const std::size_t low = rods.start[s], count = rods.start[s + 1] - low;
        std::vector<glm::vec4> points; // with half width, metres
        for (std::size_t i = 0; i < count; ++i) {
            float half_width = 1;
            for (int near = -5; near <= 5; ++near) {
                const std::size_t other =
                    (i + count + static_cast<std::size_t>(near + static_cast<int>(count))) % count;
                const float here = clear[low + other];
                half_width =
                    std::min(half_width, here + (1 - here) * smooth(1, 5.5f, std::abs(static_cast<float>(near))));
            }
            const glm::vec3 p = rods.point[low + i];
            points.emplace_back(p.x * radius_m, p.y * radius_m, p.z * radius_m * yarn.aspect, half_width * radius_m);
        }
        const float length_m = rods.length[s] * radius_m * static_cast<float>(plan.across);
        YarnPath path;
        path.aspect = yarn.aspect;
        path.plies = plan.plies;
        path.turns = ply_turn_steps(plan.plies, yarn.ply_twist_deg, plan.width_m, length_m);
        path.yarn = strand_colour[s];
        // As fine as bends and plies ask for, and no finer than texels can show.
        float step_m = spacing * radius_m;
        if (path.turns != 0)
            step_m = std::min(step_m, length_m * static_cast<float>(plan.plies) /
                                          static_cast<float>(std::abs(path.turns)) / 24);
        step_m = std::max(step_m, 0.75f * texel_m);
        const float repeat_m = rods.period.x * radius_m;
        const std::size_t fine = std::max<std::size_t>(
            8, static_cast<std::size_t>(std::ceil(length_m / static_cast<float>(plan.across) / step_m)));
        const auto point = [&](std::size_t i) { // i counts from one repeat before
            glm::vec4 p = points[i % count];
            p.x += repeat_m * (static_cast<float>(i / count) - 1);
            return p;
        };
        for (std::size_t k = 0; k <= fine * static_cast<std::size_t>(plan.across); ++k) {
            const std::size_t lap = k / fine, in_lap = k % fine;
            const float at = static_cast<float>(in_lap) / static_cast<float>(fine) * static_cast<float>(count);
            const std::size_t i = std::min(static_cast<std::size_t>(at), count - 1);
            glm::vec4 p = spline(point(i + count - 1), point(i + count), point(i + count + 1), point(i + count + 2),
                                 at - static_cast<float>(i));
            p.x += repeat_m * static_cast<float>(lap);
            path.points.push_back({glm::vec3(p), p.w});
        }
        for (int up = 0; up < plan.up; ++up) {
            YarnPath copy = path;
            const float shift = static_cast<float>(up) * rods.period.y * radius_m;
            for (YarnPath::Point& p : copy.points) p.centre_m.y += shift;
            // Neighbouring yarns must not turn in step; the golden ratio spreads their phases.
            copy.phase = 0.6180339887f * static_cast<float>(yarns.size());
            yarns.push_back(std::move(copy));
        }
    }
    return yarns;
}

} // namespace selvedge
