// bake/ply.cpp: woven repeats to yarns, yarns to plies.
#include "ply.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "error.hpp"

namespace selvedge
{

namespace
{

constexpr float pi = 3.14159265358979f;
constexpr int fewest_threads = 4; // small repeats are repeated: room for a turn of the plies

// Lengths of threads: the artist's mean times the draft's proportions.
std::vector<float> lengths(const std::vector<DraftThread>& threads, float DraftThread::*member, float mean_m)
{
    double sum = 0;
    std::size_t count = 0;
    for (const DraftThread& thread : threads)
        if (thread.*member > 0) {
            sum += static_cast<double>(thread.*member);
            ++count;
        }
    const float mean = count ? static_cast<float>(sum / static_cast<double>(count)) : 1.0f;
    std::vector<float> out;
    for (const DraftThread& thread : threads)
        out.push_back(thread.*member > 0 ? mean_m * thread.*member / mean : mean_m);
    return out;
}

// Neighbours must not lie inside each other. Returns how many widths were cut.
int fit_widths(std::vector<float>& width_m, const std::vector<float>& spacing_m)
{
    int cut = 0;
    for (std::size_t t = 0; t < width_m.size(); ++t) {
        const float before = spacing_m[(t + spacing_m.size() - 1) % spacing_m.size()], after = spacing_m[t];
        const float most = std::min(before, after);
        if (width_m[t] > most * 1.0001f) {
            width_m[t] = most;
            ++cut;
        }
    }
    return cut;
}

float total(const std::vector<float>& values)
{
    return std::accumulate(values.begin(), values.end(), 0.0f);
}

float smallest(const std::vector<float>& values)
{
    return *std::min_element(values.begin(), values.end());
}

int even_up(float texels)
{
    return std::max(2, 2 * static_cast<int>(std::ceil(texels / 2 - 1e-3f)));
}

// Half of the straight part of a race-track ply, of the yarn's half width.
float flat_share(const YarnSpec& yarn, int plies)
{
    return yarn.section == YarnSection::racetrack ? ply_radii(plies).x * (1 - yarn.aspect) : 0.0f;
}

// The wave of one yarn's axis: heights at the crossings, kept over the flat part of the crossing yarn, and a cosine
// between them.
struct Axis {
    std::vector<float> at_m, height_m, flat_m; // positions of the crossings, rising; heights there; half flat parts
    float period_m = 0;

    // length of the cosine that follows crossing i; more than 0: yarns are no wider than their spacing
    float slant_m(std::size_t i) const
    {
        const std::size_t j = (i + 1) % at_m.size();
        return (j > i ? at_m[j] : at_m[0] + period_m) - at_m[i] - flat_m[i] - flat_m[j];
    }
    // height at s, any s
    float operator()(float s) const
    {
        const std::size_t count = at_m.size();
        const float wrapped = s - period_m * std::floor((s - at_m[0]) / period_m);
        const auto next = std::upper_bound(at_m.begin(), at_m.end(), wrapped);
        const std::size_t i = static_cast<std::size_t>(next - at_m.begin()) - 1, j = (i + 1) % count;
        const float t = std::clamp((wrapped - at_m[i] - flat_m[i]) / slant_m(i), 0.0f, 1.0f);
        const float rise = height_m[j] - height_m[i];
        return height_m[i] + rise * (1 - std::cos(pi * t)) / 2;
    }
};

// Positions of axes: half of the last spacing before the first one.
std::vector<float> positions(const std::vector<float>& spacing_m)
{
    std::vector<float> out;
    float at = spacing_m.back() / 2;
    for (const float spacing : spacing_m) {
        out.push_back(at);
        at += spacing;
    }
    return out;
}

// Unit directions along a closed line of distinct points (the last one is the first, `period` further).
std::vector<glm::vec3> directions(const std::vector<glm::vec3>& line)
{
    const std::size_t count = line.size() - 1;
    const glm::vec3 period = line[count] - line[0];
    std::vector<glm::vec3> out;
    out.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
        const glm::vec3 before = i ? line[i - 1] : line[count - 1] - period;
        out.push_back(glm::normalize(line[i + 1] - before));
    }
    return out;
}

} // namespace

int ply_turn_steps(int plies, float twist_deg, float width_m, float length_m)
{
    const float helix_m = ply_radii(plies).y * width_m / 2;
    if (plies == 1 || twist_deg == 0) return 0;
    const float turns = length_m * std::tan(twist_deg * pi / 180) / (2 * pi * helix_m);
    const int steps = static_cast<int>(std::lround(turns * static_cast<float>(plies)));
    return steps != 0 ? steps : turns > 0 ? 1 : -1;
}

float ply_twist_of_steps(int steps, int plies, float width_m, float length_m)
{
    const float turns = static_cast<float>(steps) / static_cast<float>(plies);
    return std::atan(turns * 2 * pi * ply_radii(plies).y * width_m / 2 / length_m) * 180 / pi;
}

PlyModel wind_plies(glm::vec2 tile_m, const std::vector<YarnPath>& yarns)
{
    PlyModel model;
    model.tile_m = tile_m;
    std::vector<glm::vec3> line, right;
    for (const YarnPath& yarn : yarns) {
        const std::size_t count = yarn.points.size() - 1;
        const glm::vec2 radii = ply_radii(yarn.plies);
        PlyTube tube;
        tube.aspect = yarn.aspect;
        tube.yarn = yarn.yarn;
        tube.warp = yarn.warp;
        float of_width = 1; // radius before drawing out over half width
        if (yarn.section == YarnSection::racetrack) {
            const glm::vec2 along(yarn.points[count].centre_m - yarn.points[0].centre_m);
            const float flat = radii.x * (1 - yarn.aspect) * yarn.points[0].half_width_m;
            tube.flat_m = flat * glm::normalize(glm::vec2(along.y, -along.x));
            tube.aspect = 1;
            of_width = yarn.aspect;
        }
        tube.thread = static_cast<int>(&yarn - yarns.data());
        if (yarn.plies == 1) {
            for (const YarnPath::Point& point : yarn.points)
                tube.points.push_back({point.centre_m, of_width * point.half_width_m});
            model.tubes.push_back(std::move(tube));
            continue;
        }
        const glm::vec3 stretch(1, 1, 1 / yarn.aspect);
        line.clear();
        for (const YarnPath::Point& point : yarn.points) line.push_back(point.centre_m * stretch);
        const std::vector<glm::vec3> way = directions(line);

        // The frame: level at the start, then carried along.
        const auto carried = [](glm::vec3 vector, glm::vec3 along) {
            return glm::normalize(vector - along * glm::dot(vector, along));
        };
        glm::vec3 level(way[0].y, -way[0].x, 0);
        if (glm::dot(level, level) < 1e-6f) level = {1, 0, 0};
        right.assign(1, carried(level, way[0]));
        for (std::size_t i = 1; i < count; ++i) right.push_back(carried(right.back(), way[i]));
        const glm::vec3 closing = carried(right.back(), way[0]);
        const float turned = std::atan2(glm::dot(glm::cross(right[0], closing), way[0]), glm::dot(right[0], closing));

        const float plies = static_cast<float>(yarn.plies);
        const auto point = [&](int ply, std::size_t i) {
            const float share = static_cast<float>(i) / static_cast<float>(count);
            // Z twist: the near plies rise to the right of the yarn's way, seen with the way up.
            const float turn = (yarn.phase + static_cast<float>(ply) - static_cast<float>(yarn.turns) * share) / plies;
            const float angle = 2 * pi * (turn - std::floor(turn)) + turned * share;
            const glm::vec3 up = glm::cross(right[i], way[i]);
            const float half_width = yarn.points[i].half_width_m;
            return PlyPoint{(line[i] + half_width * radii.y * (std::cos(angle) * right[i] + std::sin(angle) * up)) /
                                stretch,
                            of_width * half_width * radii.x};
        };
        const glm::vec3 period = yarn.points.back().centre_m - yarn.points.front().centre_m;
        for (int ply = 0; ply < yarn.plies; ++ply) {
            tube.points.clear();
            tube.points.reserve(count + 1);
            for (std::size_t i = 0; i < count; ++i) tube.points.push_back(point(ply, i));
            const int turns = yarn.turns % yarn.plies;
            const int next = (ply - turns + yarn.plies) % yarn.plies, last = (ply + turns + yarn.plies) % yarn.plies;
            const PlyPoint end = point(next, 0);
            tube.points.push_back({end.centre_m + period, end.radius_m});
            tube.before_m = point(last, count - 1).centre_m - period;
            tube.after_m = point(next, 1).centre_m + period;
            model.tubes.push_back(tube);
        }
    }
    return model;
}

WovenPlan plan_woven(const Fabric& fabric, int resolution)
{
    WovenPlan plan;
    const YarnTypes types = yarn_types(fabric);
    if (!types.warning.empty()) plan.warnings.push_back(types.warning);

    // Threads that differ in nothing one can see are the same thread.
    Draft draft = fabric.draft;
    for (std::size_t e = 0; e < draft.ends.size(); ++e) draft.ends[e].colour = types.end_type[e];
    for (std::size_t p = 0; p < draft.picks.size(); ++p) draft.picks[p].colour = types.pick_type[p];
    // Proportions are taken before the repeat is cut: the mean over the draft is the artist's number.
    const auto proportions = [](std::vector<DraftThread>& threads) {
        const auto spacing = lengths(threads, &DraftThread::spacing_m, 1),
                   thickness = lengths(threads, &DraftThread::thickness_m, 1);
        for (std::size_t t = 0; t < threads.size(); ++t) {
            threads[t].spacing_m = spacing[t];
            threads[t].thickness_m = thickness[t];
        }
    };
    proportions(draft.ends);
    proportions(draft.picks);
    draft = smallest_repeat(draft);
    const auto times = [](std::size_t threads) {
        return (fewest_threads + static_cast<int>(threads) - 1) /
               static_cast<int>(std::min(threads, std::size_t(fewest_threads)));
    };
    plan.repeat = repeated(draft, draft.ends.size() < fewest_threads ? times(draft.ends.size()) : 1,
                           draft.picks.size() < fewest_threads ? times(draft.picks.size()) : 1);

    for (const DraftThread& end : plan.repeat.ends) {
        plan.end_type.push_back(end.colour);
        plan.end_spacing_m.push_back(fabric.warp.spacing_m * end.spacing_m);
        plan.end_width_m.push_back(fabric.warp.width_m * end.thickness_m);
    }
    for (const DraftThread& pick : plan.repeat.picks) {
        plan.pick_type.push_back(pick.colour);
        plan.pick_spacing_m.push_back(fabric.weft.spacing_m * pick.spacing_m);
        plan.pick_width_m.push_back(fabric.weft.width_m * pick.thickness_m);
    }
    if (const int cut =
            fit_widths(plan.end_width_m, plan.end_spacing_m) + fit_widths(plan.pick_width_m, plan.pick_spacing_m))
        plan.warnings.push_back(format_text("%d of %zu yarns are wider than their spacing: narrowed to it", cut,
                                            plan.end_width_m.size() + plan.pick_width_m.size()));
    plan.tile_m = {total(plan.end_spacing_m), total(plan.pick_spacing_m)};

    // Texels: square as far as even counts allow.
    const float longer_m = std::max(plan.tile_m.x, plan.tile_m.y);
    const float narrowest_m = std::min(smallest(plan.end_width_m), smallest(plan.pick_width_m));
    const auto side_for = [&](float texels_across) { return longer_m / narrowest_m * texels_across; };
    float side = static_cast<float>(std::min(resolution, side_limit));
    if (side_for(texels_per_yarn) > side) {
        const float wished = std::min(side_for(texels_per_yarn), static_cast<float>(side_limit));
        if (side_for(1.5f) > static_cast<float>(side_limit))
            throw InputError(
                fabric.path.empty() ? fabric.name : fabric.path, 0,
                "repeat of %zu ends x %zu picks, %.3g x %.3g m, needs %.0f texels a side for 1.5 texels across "
                "the finest yarn, expected at most %d",
                plan.repeat.ends.size(), plan.repeat.picks.size(), static_cast<double>(plan.tile_m.x),
                static_cast<double>(plan.tile_m.y), static_cast<double>(side_for(1.5f)), side_limit);
        plan.warnings.push_back(
            format_text("resolution raised from %d to %d: %.2g texels across the finest yarn (%d wished)", resolution,
                        even_up(wished), static_cast<double>(wished / side_for(1)), texels_per_yarn));
        side = wished;
    }
    const float texel_m = longer_m / static_cast<float>(even_up(side));
    plan.size = {std::min(even_up(plan.tile_m.x / texel_m), side_limit),
                 std::min(even_up(plan.tile_m.y / texel_m), side_limit)};

    const auto fit_plies = [&](const YarnSpec& yarn, const std::vector<float>& width_m, float length_m,
                               const char* system, int& plies, int& steps) {
        const float mean_m = total(width_m) / static_cast<float>(width_m.size());
        plies = yarn.plies;
        if (plies > 1 && mean_m / texel_m < fewest_texels_for_plies) {
            plan.warnings.push_back(format_text("%s yarns are %.2g texels wide: their %d plies are drawn as one",
                                                system, static_cast<double>(mean_m / texel_m), plies));
            plies = 1;
        }
        steps = ply_turn_steps(plies, yarn.ply_twist_deg, mean_m, length_m);
        const float got = ply_twist_of_steps(steps, plies, mean_m, length_m);
        if (plies > 1 && std::abs(got - yarn.ply_twist_deg) > 4)
            plan.warnings.push_back(format_text("%s ply twist %.3g deg drawn as %.3g, so that the tile closes", system,
                                                static_cast<double>(yarn.ply_twist_deg), static_cast<double>(got)));
    };
    fit_plies(fabric.warp, plan.end_width_m, plan.tile_m.y, "warp", plan.warp_plies, plan.warp_turns);
    fit_plies(fabric.weft, plan.pick_width_m, plan.tile_m.x, "weft", plan.weft_plies, plan.weft_turns);
    return plan;
}

std::vector<YarnPath> weave_yarns(const Fabric& fabric, const WovenPlan& plan)
{
    std::vector<YarnPath> yarns;
    const std::vector<float> end_at = positions(plan.end_spacing_m), pick_at = positions(plan.pick_spacing_m);
    const float texel_m =
        std::max(plan.tile_m.x / static_cast<float>(plan.size.x), plan.tile_m.y / static_cast<float>(plan.size.y));

    // Shares of the crimp: only their proportion counts where both are stated.
    float warp_share = fabric.warp.crimp.value_or(1 - fabric.weft.crimp.value_or(0.5f));
    float weft_share = fabric.weft.crimp.value_or(1 - warp_share);
    const float sum = warp_share + weft_share;
    warp_share = sum > 1e-3f ? warp_share / sum : 0.5f;
    weft_share = 1 - warp_share;

    const auto thread = [&](bool warp, std::size_t index) {
        const YarnSpec& yarn = warp ? fabric.warp : fabric.weft;
        const YarnSpec& other = warp ? fabric.weft : fabric.warp;
        const auto& crossing_width = warp ? plan.pick_width_m : plan.end_width_m;
        const float crossing_flat = flat_share(other, warp ? plan.weft_plies : plan.warp_plies);
        const float half_width = (warp ? plan.end_width_m : plan.pick_width_m)[index] / 2;
        const float across = (warp ? end_at : pick_at)[index];
        const float share = warp ? warp_share : weft_share;
        const float length = warp ? plan.tile_m.y : plan.tile_m.x;
        const int plies = warp ? plan.warp_plies : plan.weft_plies;
        const int steps = warp ? plan.warp_turns : plan.weft_turns;

        Axis axis;
        axis.at_m = warp ? pick_at : end_at;
        axis.period_m = length;
        for (std::size_t c = 0; c < axis.at_m.size(); ++c) {
            const bool on_top = plan.repeat.warp_on_top(warp ? c : index, warp ? index : c) == warp;
            const float reach = share * (yarn.aspect * half_width + other.aspect * crossing_width[c] / 2);
            axis.height_m.push_back(on_top ? reach : -reach);
            axis.flat_m.push_back(crossing_flat * crossing_width[c] / 2);
        }

        // Fine enough for the cosine between two crossings and for the helix, and never finer than texels can show.
        float step_m = length;
        for (std::size_t c = 0; c < axis.at_m.size(); ++c) step_m = std::min(step_m, axis.slant_m(c) / 8);
        if (steps != 0)
            step_m = std::min(step_m, length * static_cast<float>(plies) / static_cast<float>(std::abs(steps)) / 32);
        const int count = static_cast<int>(std::ceil(length / std::max(step_m, 0.75f * texel_m) - 1e-3f));
        YarnPath path;
        path.aspect = yarn.aspect;
        path.section = yarn.section;
        path.warp = warp;
        path.yarn = (warp ? plan.end_type : plan.pick_type)[index];
        path.plies = plies;
        path.turns = steps;
        // Neighbouring yarns must not turn in step; the golden ratio spreads their phases.
        path.phase = 0.6180339887f * static_cast<float>(index + (warp ? 1 : 0));
        path.points.reserve(static_cast<std::size_t>(count) + 1);
        for (int k = 0; k <= count; ++k) {
            const float s = static_cast<float>(k % count) / static_cast<float>(count) * length;
            const float along = k == count ? length : s, height = axis(s);
            path.points.push_back(
                {warp ? glm::vec3(across, along, height) : glm::vec3(along, across, height), half_width});
        }
        yarns.push_back(std::move(path));
    };
    for (std::size_t e = 0; e < end_at.size(); ++e) thread(true, e);
    for (std::size_t p = 0; p < pick_at.size(); ++p) thread(false, p);
    return yarns;
}

} // namespace selvedge
