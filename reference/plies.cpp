// reference/plies.cpp: tubes to meshes, meshes to places, paths among them.
#include "reference/plies.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "bake/error.hpp"

namespace selvedge
{

namespace f32 = cloth::f32;

namespace
{

constexpr int ring_sides = 32;      // of a tube's section: the chords lie at most .5 % of the radius off the circle
constexpr int surface_limit = 4096; // surfaces on one ray before it is given up
constexpr std::uint64_t matte_key = ~std::uint64_t(0); // of what is no yarn
constexpr float faint = 1e-6f;                         // a shadow ray that brings less brings nothing
constexpr float forever = std::numeric_limits<float>::infinity();

// What the plies' surface is shaded with: the point BSDF alone, since the rays are the visibility.
constexpr f32::ClothSettings point_settings{f32::cloth_bsdf_micro,
                                            f32::cloth_weight_relief,
                                            f32::cloth_visibility_none,
                                            f32::cloth_slab_ply,
                                            false,
                                            false,
                                            false};

// Start of a ray on the side of n: less than a hundredth of a fibre off the surface, more than float rounds.
glm::vec3 leave(glm::vec3 position, glm::vec3 n)
{
    const float scale = std::max({std::abs(position.x), std::abs(position.y), std::abs(position.z)});
    return position + n * (5e-9f + 2e-7f * scale);
}

// The way through point i of a tube in the space where its section is round, from both of its neighbours.
glm::vec3 way_at(const PlyTube& tube, std::size_t i, glm::vec3 stretch)
{
    const std::size_t last = tube.points.size() - 1;
    const glm::vec3 period = tube.points[last].centre_m - tube.points[0].centre_m;
    const glm::vec3 before = i > 0           ? tube.points[i - 1].centre_m
                             : tube.before_m ? *tube.before_m
                                             : tube.points[last - 1].centre_m - period;
    const glm::vec3 after = i < last       ? tube.points[i + 1].centre_m
                            : tube.after_m ? *tube.after_m
                                           : tube.points[1].centre_m + period;
    const glm::vec3 here = tube.points[i].centre_m;
    return glm::normalize(glm::normalize((here - before) * stretch) + glm::normalize((after - here) * stretch));
}

} // namespace

// One repeat of the tubes, as it stands at tile (0, 0) of its object.
struct PlyScene::TubeMesh {
    std::vector<glm::vec3> positions; // [m], of the instance's space
    std::vector<glm::vec3> normals;   // unit, smooth
    std::vector<glm::vec3> along;     // the ply's way, unit
    std::vector<glm::vec2> tile;      // place on the cloth, in repeats; may lie beyond [0, 1)
    std::vector<glm::uvec3> triangles;
    std::vector<std::uint16_t> thread, yarn; // per triangle
    std::vector<glm::ivec2> period;          // per thread: repeats from one end to the other

    void add(const PlyTube& tube, glm::vec2 tile_m);
    void bend(const glm::mat2& plane, float scale_z, float radius);
};

void PlyScene::TubeMesh::add(const PlyTube& tube, glm::vec2 tile_m)
{
    const glm::vec3 stretch(1, 1, 1 / tube.aspect);
    constexpr float turn = 2 * std::numbers::pi_v<float> / ring_sides;
    const float swell = std::sqrt(turn / std::sin(turn)); // the polygon has the circle's area
    const std::size_t first = positions.size();
    // A race-track is a ring that is cut open at its top and bottom vertices, which both halves keep, and drawn apart.
    const bool cut = tube.flat_m != glm::vec2(0);
    const int sides = ring_sides + (cut ? 2 : 0);
    glm::vec3 right_before(0);
    int shift = 0; // by which vertex numbers have turned since the first ring
    std::vector<int> shifts;
    for (std::size_t i = 0; i < tube.points.size(); ++i) {
        // A ring depends on its point alone, so that the tube's ends meet.
        const glm::vec3 way = way_at(tube, i, stretch);
        const glm::vec3 level(way.y, -way.x, 0);
        const glm::vec3 right = glm::dot(level, level) > 1e-6f ? glm::normalize(level) : f32::cloth_frame(way).x;
        const glm::vec3 up = glm::cross(right, way);
        if (i > 0)
            shift += int(std::lround(std::atan2(glm::dot(right_before, up), glm::dot(right_before, right)) / turn));
        shifts.push_back(shift);
        right_before = right;
        const glm::vec3 apart = glm::vec3(glm::dot(glm::vec2(right), tube.flat_m) < 0 ? -tube.flat_m : tube.flat_m, 0);
        for (int k = 0; k < sides; ++k) {
            const int cuts_before = !cut ? 0 : k > 3 * ring_sides / 4 + 1 ? 2 : k > ring_sides / 4 ? 1 : 0;
            const float angle = turn * float(k - cuts_before);
            const glm::vec3 out = std::cos(angle) * right + std::sin(angle) * up;
            const glm::vec3 at = tube.points[i].centre_m * stretch + (cuts_before == 1 ? -apart : apart) +
                                 tube.points[i].radius_m * swell * out;
            positions.push_back(at / stretch);
            normals.push_back(glm::normalize(out * stretch));
            along.push_back(glm::normalize(way / stretch));
            tile.push_back(glm::vec2(at) / tile_m);
        }
    }
    const auto vertex = [&](std::size_t ring, int k) {
        const int turned = ((k + shifts[ring]) % sides + sides) % sides;
        return std::uint32_t(first + ring * std::size_t(sides) + std::size_t(turned));
    };
    for (std::size_t i = 0; i + 1 < tube.points.size(); ++i)
        for (int k = 0; k < sides; ++k) {
            // right, up, way: `up` is a quarter turn from `right` seen against the way.
            triangles.push_back({vertex(i, k), vertex(i + 1, k), vertex(i + 1, k + 1)});
            triangles.push_back({vertex(i, k), vertex(i + 1, k + 1), vertex(i, k + 1)});
            for (int t = 0; t < 2; ++t) {
                thread.push_back(std::uint16_t(tube.thread));
                yarn.push_back(std::uint16_t(tube.yarn));
            }
        }
    const glm::vec3 ends = tube.points.back().centre_m - tube.points.front().centre_m;
    if (period.size() <= std::size_t(tube.thread)) period.resize(std::size_t(tube.thread) + 1);
    period[std::size_t(tube.thread)] = glm::ivec2(glm::round(glm::vec2(ends) / tile_m));
}

// Onto a cylinder about y: `plane` takes x and y to the way around and the height [m], z is measured outwards.
void PlyScene::TubeMesh::bend(const glm::mat2& plane, float scale_z, float radius)
{
    const glm::mat2 cofactor(plane[1].y, -plane[1].x, -plane[0].y, plane[0].x); // inverse transpose, times determinant
    const float area = glm::determinant(plane);
    for (std::size_t v = 0; v < positions.size(); ++v) {
        const glm::vec2 at = plane * glm::vec2(positions[v]);
        const float angle = at.x / radius, out = radius + positions[v].z * scale_z;
        const float s = std::sin(angle), c = std::cos(angle), wide = out / radius; // the way around grows by this
        const auto turned = [&](glm::vec2 flat, float z) {
            return glm::normalize(glm::vec3(c * flat.x + s * z, flat.y, -s * flat.x + c * z));
        };
        const glm::vec2 n = cofactor * glm::vec2(normals[v]) / area, way = plane * glm::vec2(along[v]);
        normals[v] = turned({n.x / wide, n.y}, normals[v].z / scale_z);
        along[v] = turned({way.x * wide, way.y}, along[v].z * scale_z);
        positions[v] = {out * s, at.y, out * c};
    }
}

// A value between a triangle's corners.
template <class Values, class Entry> static auto mix(const Values& values, glm::uvec3 corner, const Entry& at)
{
    return (1 - at.u - at.v) * values[corner.x] + at.u * values[corner.y] + at.v * values[corner.z];
}

// The columns of a placement are perpendicular, so the inverse transpose divides each by its squared length.
static glm::vec3 normal_to_world(const glm::mat4x3& to_world, glm::vec3 n)
{
    const glm::mat3 turn(to_world);
    const glm::vec3 lengths(glm::dot(turn[0], turn[0]), glm::dot(turn[1], turn[1]), glm::dot(turn[2], turn[2]));
    return glm::normalize(turn * (n / lengths));
}

// The yarns that a ray is inside of and has answered for: it may leave them freely.
struct PlyScene::Inside {
    struct Yarn {
        std::uint64_t key;
        int depth; // plies of it around the ray
    };
    std::array<Yarn, 8> yarns;
    int count = 0;

    Yarn* find(std::uint64_t key)
    {
        for (int k = 0; k < count; ++k)
            if (yarns[std::size_t(k)].key == key) return &yarns[std::size_t(k)];
        return nullptr;
    }
    void add(std::uint64_t key)
    {
        if (count == int(yarns.size())) remove(&yarns[0]); // more than eight yarns in one place are none
        yarns[std::size_t(count++)] = {key, 1};
    }
    void remove(Yarn* yarn) { *yarn = yarns[std::size_t(--count)]; }
};

// Where a ray enters or leaves a yarn, or meets something matte.
struct PlyScene::Entry {
    std::uint32_t instance = ~0u, triangle = ~0u;
    float u = 0, v = 0, distance = 0;
    std::uint64_t key = 0; // of the yarn
};

// How a ray that has scattered goes on.
struct PlyScene::Departure {
    glm::vec3 origin{0};
    Inside inside;
    Entry from; // the triangle that it starts on
};

std::vector<PlyModel> ply_models(const Scene& scene)
{
    std::vector<PlyModel> models;
    for (const SceneObject& object : scene.objects)
        models.push_back(object.fabric >= 0 ? ply_model(scene.fabric_sources[std::size_t(object.fabric)]) : PlyModel{});
    return models;
}

PlyScene::PlyScene(const Scene& scene, const std::vector<PlyModel>& models) : scene_(scene), lights_(lights_of(scene))
{
    std::vector<InstancedMesh> meshes;
    std::vector<Instance> instances;
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
        const SceneObject& object = scene.objects[k];
        maps_.push_back(object.fabric >= 0 ? maps_of(scene.fabrics[std::size_t(object.fabric)]) : f32::ClothMaps{});
        if (object.fabric >= 0) {
            place_fabric(k, models[k], meshes, instances);
            continue;
        }
        meshes.push_back({object.mesh.positions, object.mesh.triangles});
        instances.push_back({std::uint32_t(meshes.size() - 1), glm::mat4x3(1)});
        instances_.push_back({std::uint32_t(k), -1, glm::ivec2(0), glm::mat4x3(1)});
    }
    for (const InstancedMesh& mesh : meshes) triangles_ += mesh.triangles.size();
    rays_ = std::make_unique<InstancedRays>(meshes, instances);
}

PlyScene::~PlyScene() = default;

void PlyScene::place_fabric(std::size_t index, const PlyModel& model, std::vector<InstancedMesh>& meshes,
                            std::vector<Instance>& instances)
{
    const SceneObject& object = scene_.objects[index];
    const bool plane = object.shape == "plane";
    if (!plane && object.shape != "cylinder")
        throw InputError(object.name, 0, "found a fabric on another shape, plies expect plane or cylinder");
    // As make_shape has them: plane u along x, v along -z, front +y; cylinder u around y from z to x, v along y.
    const glm::dvec3 x(object.to_world[0]), y(object.to_world[1]), z(object.to_world[2]), origin(object.to_world[3]);
    if (glm::dot(glm::cross(x, y), z) <= 0.0)
        throw InputError(object.name, 0, "found a mirroring scale, plies expect one that keeps left and right");
    const double radius = glm::length(x);
    if (!plane && std::abs(glm::length(z) / radius - 1.0) > 1e-3)
        throw InputError(object.name, 0, "found an oval cylinder, plies expect a round one");
    // A repeat's edges, first in UV, then in metres along u and v.
    const glm::dmat2 uv_from_tiles = glm::inverse(object.tiles_from_uv);
    const glm::dvec2 size(plane ? radius : 2.0 * std::numbers::pi * radius, glm::length(plane ? z : y));
    glm::dmat2 edge{size * uv_from_tiles[0], size * uv_from_tiles[1]};
    // Repeats that have to close around a cylinder have to lie straight, too.
    glm::dvec2 count(0.0);
    const int around = plane || std::abs(edge[0].x) > std::abs(edge[0].y) ? 0 : 1; // which edge goes around
    if (!plane) {
        if (std::abs(edge[around].y) > 1e-4 * std::abs(edge[around].x))
            throw InputError(object.name, 0,
                             "found the fabric turned by other than quarter turns, plies on a cylinder "
                             "expect those (see uv_rotation)");
        const glm::dvec2 exact(size.x / std::abs(edge[around].x), size.y / std::abs(edge[1 - around].y));
        count = glm::max(glm::round(exact), glm::dvec2(1.0));
        edge[around].x *= exact.x / count.x;
        warnings_.push_back(format_text("%s: %.2f repeats of the fabric around it, plies stand on %.0f",
                                        object.name.c_str(), exact.x, count.x));
    }
    const glm::dvec2 scales = glm::dvec2(glm::length(edge[0]), glm::length(edge[1])) / glm::dvec2(model.tile_m);
    const double sheared = std::abs(glm::dot(edge[0], edge[1])) / (glm::length(edge[0]) * glm::length(edge[1]));
    if (!(std::abs(scales.x / scales.y - 1.0) <= stretch_limit && sheared <= stretch_limit))
        throw InputError(object.name, 0,
                         "found the fabric stretched by %.3g along its weft and %.3g along its warp, plies expect the "
                         "same and a right angle (see uv_scale)",
                         scales.x, scales.y);
    const double scale = std::sqrt(scales.x * scales.y);
    const double repeats = size.x * size.y / std::abs(glm::determinant(edge));
    if (!(repeats + double(instances_.size()) <= instance_limit))
        throw InputError(object.name, 0, "found %.0f repeats of the fabric, plies expect %.0f at most", repeats,
                         instance_limit);

    TubeMesh mesh;
    for (const PlyTube& tube : model.tubes) mesh.add(tube, model.tile_m);
    const glm::dvec3 across = glm::normalize(x), up = glm::normalize(plane ? -z : y),
                     out = glm::normalize(plane ? y : z);
    const auto place = [&](glm::ivec2 tile, const glm::dmat4x3& to_world) {
        instances.push_back({std::uint32_t(meshes.size()), glm::mat4x3(to_world)});
        instances_.push_back({std::uint32_t(index), std::int32_t(tubes_.size()), tile, glm::mat4x3(to_world)});
    };
    if (plane) {
        const glm::dvec3 corner = origin - 0.5 * x + 0.5 * z;
        const auto on_plane = [&](glm::dvec2 metres) { return across * metres.x + up * metres.y; };
        // Whole repeats: those whose middle lies on the plane.
        glm::dvec2 low(std::numeric_limits<double>::max()), high(std::numeric_limits<double>::lowest());
        for (const glm::dvec2 uv : {glm::dvec2(0, 0), {1, 0}, {0, 1}, {1, 1}}) {
            low = glm::min(low, object.tiles_from_uv * uv);
            high = glm::max(high, object.tiles_from_uv * uv);
        }
        for (int j = int(std::floor(low.y)); j < int(std::ceil(high.y)); ++j)
            for (int i = int(std::floor(low.x)); i < int(std::ceil(high.x)); ++i) {
                const glm::dvec2 middle = uv_from_tiles * glm::dvec2(i + 0.5, j + 0.5);
                if (middle.x < 0.0 || middle.x >= 1.0 || middle.y < 0.0 || middle.y >= 1.0) continue;
                place({i, j}, {on_plane(edge[0]) / double(model.tile_m.x), on_plane(edge[1]) / double(model.tile_m.y),
                               out * scale, corner + on_plane(edge * glm::dvec2(i, j))});
            }
    } else {
        mesh.bend(glm::mat2(edge[0] / double(model.tile_m.x), edge[1] / double(model.tile_m.y)), float(scale),
                  float(radius));
        const bool forward[2] = {edge[around].x > 0.0, edge[1 - around].y > 0.0};
        for (int b = 0; b < int(count.y); ++b)
            for (int a = 0; a < int(count.x); ++a) {
                glm::ivec2 tile;
                tile[around] = forward[0] ? a : -1 - a;
                tile[1 - around] = forward[1] ? b : -1 - b;
                const glm::dvec2 at = edge * glm::dvec2(tile);
                const double angle = at.x / radius, c = std::cos(angle), s = std::sin(angle);
                place(tile, {c * across - s * out, up, s * across + c * out, origin - 0.5 * y + up * at.y});
            }
    }
    meshes.push_back({mesh.positions, mesh.triangles});
    tubes_.push_back(std::move(mesh));
}

// The next triangle on the ray but for `from`; whose it is, and whether the ray enters. Moves `near` past it.
bool PlyScene::next_hit(glm::vec3 origin, glm::vec3 direction, const Entry& from, float& near, float far, Entry& hit,
                        bool& entering, std::uint64_t& rays) const
{
    for (;;) {
        ++rays;
        const InstancedRays::Hit met = rays_->closest(origin, direction, near, far);
        if (!met.any) return false;
        near = std::nextafter(met.distance, forever);
        if (met.instance == from.instance && met.triangle == from.triangle) continue;
        hit = {met.instance, met.triangle, met.u, met.v, met.distance, matte_key};
        entering = true;
        const Placed& placed = instances_[met.instance];
        if (placed.mesh < 0) return true;
        const TubeMesh& mesh = tubes_[std::size_t(placed.mesh)];
        const std::uint16_t thread = mesh.thread[met.triangle];
        // A thread goes on from repeat to repeat along its period; beside it lies another one.
        const glm::ivec2 period = mesh.period[thread];
        const std::int32_t lane = placed.tile.x * period.y - placed.tile.y * period.x;
        hit.key = (std::uint64_t(placed.object) << 48) | (std::uint64_t(thread) << 32) | std::uint32_t(lane);
        const glm::uvec3 corner = mesh.triangles[met.triangle];
        const glm::vec3 n = glm::cross(mesh.positions[corner.y] - mesh.positions[corner.x],
                                       mesh.positions[corner.z] - mesh.positions[corner.x]);
        // Columns of the placement are perpendicular: its transpose asks for the sign alone.
        entering = glm::dot(n, glm::transpose(glm::mat3(placed.to_world)) * direction) < 0.0f;
        return true;
    }
}

// The next yarn that the ray enters, or the next matte surface. Moves `near` past it and keeps `inside` right.
bool PlyScene::next(glm::vec3 origin, glm::vec3 direction, const Entry& from, float& near, float far, Inside& inside,
                    Entry& entry, std::uint64_t& rays) const
{
    for (int k = 0; k < surface_limit; ++k) {
        bool entering = false;
        if (!next_hit(origin, direction, from, near, far, entry, entering, rays)) return false;
        if (Inside::Yarn* yarn = inside.find(entry.key)) {
            yarn->depth += entering ? 1 : -1;
            if (yarn->depth <= 0) inside.remove(yarn);
            continue;
        }
        if (entering) return true; // else the seam between two triangles, seen from within
    }
    return false;
}

// Where the ray that has just entered the yarn of `entry` leaves it on its straight way: false where it does not, at
// the open end of a tube.
//   at  start of a ray that goes on from there. Another yarn that lies in the way, as yarns may overlap, is where the
//       two touch: the ray goes on from there, and leaves this one without more ado
bool PlyScene::leaves(glm::vec3 origin, glm::vec3 direction, const Entry& entry, const Inside& before, Entry& exit,
                      Departure& at, std::uint64_t& rays) const
{
    at.inside = before;
    at.inside.add(entry.key);
    int depth = 1;
    bool touched = false;
    float near = std::nextafter(entry.distance, forever);
    for (int k = 0; k < surface_limit; ++k) {
        bool entering = false;
        if (!next_hit(origin, direction, entry, near, forever, exit, entering, rays)) return false;
        if (exit.key == entry.key) depth += entering ? 1 : -1;
        if (!touched) {
            if (Inside::Yarn* yarn = at.inside.find(exit.key)) {
                yarn->depth += entering ? 1 : -1;
                if (yarn->depth <= 0) at.inside.remove(yarn);
            } else if (entering) {
                touched = true;
                const float length = glm::length(direction);
                const float back = 5e-9f + 4e-7f * (glm::length(origin) + exit.distance * length);
                at.origin = origin + direction * std::max(exit.distance - back / length, entry.distance);
                at.from = entry;
            }
        }
        if (exit.key == matte_key) return false;
        if (depth > 0) continue;
        if (!touched) {
            const glm::vec3 normal = normal_at(exit);
            at.origin = leave(position_at(exit), normal);
            at.from = exit;
        }
        return true;
    }
    return false;
}

glm::vec3 PlyScene::position_at(const Entry& entry) const
{
    const Placed& placed = instances_[entry.instance];
    const TubeMesh& mesh = tubes_[std::size_t(placed.mesh)];
    return glm::mat3(placed.to_world) * mix(mesh.positions, mesh.triangles[entry.triangle], entry) + placed.to_world[3];
}

// The smooth normal of the ply, on its outside.
glm::vec3 PlyScene::normal_at(const Entry& entry) const
{
    const Placed& placed = instances_[entry.instance];
    const TubeMesh& mesh = tubes_[std::size_t(placed.mesh)];
    return normal_to_world(placed.to_world, mix(mesh.normals, mesh.triangles[entry.triangle], entry));
}

// Surface and BSDF where the ray enters the yarn, or leaves it: frame z is the normal of the ply there, against the
// ray.
void PlyScene::shade(const Entry& entry, bool leaving, glm::vec3 direction, PlyVertex& vertex) const
{
    const Placed& placed = instances_[entry.instance];
    const TubeMesh& mesh = tubes_[std::size_t(placed.mesh)];
    const glm::uvec3 corner = mesh.triangles[entry.triangle];
    const float sign = leaving ? -1.0f : 1.0f;
    const glm::vec3 wo = -glm::normalize(direction);
    glm::vec3 outside = normal_at(entry);
    if (sign * glm::dot(outside, wo) <= 0)
        outside = normal_to_world(placed.to_world, glm::cross(mesh.positions[corner.y] - mesh.positions[corner.x],
                                                              mesh.positions[corner.z] - mesh.positions[corner.x]));
    const glm::vec3 way = glm::mat3(placed.to_world) * mix(mesh.along, corner, entry);
    const glm::vec3 along = f32::cloth_unit_vector(way - outside * glm::dot(outside, way), f32::cloth_frame(outside).x);
    const glm::vec2 at = mix(mesh.tile, corner, entry);
    const glm::ivec2 tile = placed.tile + glm::ivec2(glm::floor(at));

    const f32::ClothMaps& maps = maps_[placed.object];
    f32::ClothSelection selection;
    selection.passes = false;
    selection.weight = 1;
    selection.side = 0;
    selection.spot = f32::cloth_spot_at(maps, at);
    selection.horizons = glm::uvec4(0); // point_settings ask for none
    selection.yarn = f32::cloth_fetch_yarn(maps, mesh.yarn[entry.triangle]);
    const glm::vec2 twist = scene_.model.settings.twist_noise
                                ? f32::cloth_twist(maps, selection.yarn.twist, selection.spot >> 2, tile)
                                : selection.yarn.twist;
    const glm::vec3 tangent = twist.x * along + twist.y * glm::cross(outside, along);

    vertex.object = placed.object;
    vertex.distance = entry.distance;
    f32::ClothSurface& surface = vertex.surface;
    surface.position = position_at(entry);
    surface.normal_g = sign * outside;
    surface.frame = f32::cloth_frame(surface.normal_g);
    surface.wo = f32::cloth_to_local(surface.frame, wo);
    surface.wo.z = std::max(surface.wo.z, 1e-6f);
    surface.tile = at;
    surface.tile_dx = surface.tile_dy = glm::vec2(0);
    surface.side = 0;
    const glm::vec3 fibre = f32::cloth_to_local(surface.frame, tangent);
    selection.texel.point = {{0, 0, 1}, {0, 0, 1}, fibre, fibre, 1, 1};
    selection.texel.slope_f = glm::vec2(0);
    selection.texel.yarn = mesh.yarn[entry.triangle];
    selection.texel.gap = false;
    selection.texel.openness_f = selection.texel.openness_b = 1;
    vertex.shading = f32::cloth_shade_fabric(selection, point_settings);
}

static float unscattered(const PlyVertex& vertex)
{
    const f32::ClothSelection& selection = vertex.shading.selection;
    return f32::cloth_unscattered(selection.yarn, selection.texel.point.normal_f, selection.texel.point.tangent,
                                  vertex.surface.wo);
}

// The first surface that the ray does not pass between the fibres of, and which of its lobes answers for it.
//   from  in: where the ray starts; out: where it goes on, on the side of the lobe
//   seen  the surface as it meets the eye; `vertex` may lie on its other side
bool PlyScene::find_vertex(const f32::ClothRay& ray, f32::ClothRandom random, Departure& from, PlyCounters& counters,
                           PlyVertex& seen, PlyVertex& vertex) const
{
    float near = 0;
    for (std::uint32_t layer = 0;; ++layer) {
        Entry entry, exit;
        if (!next(ray.origin, ray.direction, from.from, near, forever, from.inside, entry, counters.rays)) return false;
        const Placed& placed = instances_[entry.instance];
        if (placed.mesh < 0) {
            const SceneObject& object = scene_.objects[placed.object];
            seen.object = placed.object;
            seen.distance = entry.distance;
            seen.surface = f32::cloth_surface(triangle_of(object, entry.triangle), ray);
            seen.shading = f32::cloth_shade_plain(object.albedo, object.roughness);
            vertex = seen;
            from.origin = leave(seen.surface.position, seen.surface.normal_g);
            from.from = entry;
            return true;
        }
        shade(entry, false, ray.direction, seen);
        Departure beyond;
        PlyVertex other = seen;
        const bool crosses = leaves(ray.origin, ray.direction, entry, from.inside, exit, beyond, counters.rays);
        if (crosses) shade(exit, true, ray.direction, other);
        const float through = 0.5f * (unscattered(seen) + unscattered(other));
        f32::ClothRandom layer_random = random;
        layer_random.seed = f32::cloth_hash_combine(random.seed, layer);
        const glm::vec2 pick = f32::cloth_draw(layer_random, f32::cloth_dim_pick);
        if (pick.y < through) {
            from.inside.add(entry.key);
            continue;
        }
        // One lobe: reflection, or transmission that bends where the ray enters or, as often, where it leaves.
        const glm::vec4 lobes = f32::cloth_lobe_weights(seen.shading.selection.yarn);
        const float reflects = lobes.x + lobes.z;
        const bool black = lobes.x + lobes.y + lobes.z + lobes.w <= 0;
        const bool reflected = black || pick.x < reflects;
        const bool enters = pick.x < 0.5f * (1 + reflects) || !crosses;
        vertex = reflected || enters ? seen : other;
        f32::ClothSelection& selection = vertex.shading.selection;
        // As in cloth_select: who is shaded stands for the draws that passed as well.
        selection.weight = 1 / std::max(1 - through, 1e-3f) / (black ? 1 : reflected ? reflects : 1 - reflects);
        if (reflected) {
            selection.yarn.albedo_t = selection.yarn.diffuse_t = glm::vec3(0);
            from.origin = leave(vertex.surface.position, vertex.surface.normal_g);
            from.from = entry;
        } else {
            selection.yarn.albedo_r = selection.yarn.diffuse_r = glm::vec3(0);
            if (enters) {
                from.origin = leave(vertex.surface.position, -vertex.surface.normal_g);
                from.from = entry;
                from.inside.add(entry.key);
            } else {
                from = beyond;
            }
        }
        return true;
    }
}

// Share of the light that goes straight from the far end to a departure: 0 behind matte, less what yarns scatter.
float PlyScene::transmittance(Departure from, glm::vec3 direction, float far, PlyCounters& counters) const
{
    float near = 0, share = 1;
    PlyVertex vertex;
    while (share > faint) {
        Entry entry, exit;
        if (!next(from.origin, direction, from.from, near, far, from.inside, entry, counters.shadow_rays)) return share;
        if (instances_[entry.instance].mesh < 0) return 0;
        shade(entry, false, direction, vertex);
        float through = unscattered(vertex);
        Departure beyond;
        if (leaves(from.origin, direction, entry, from.inside, exit, beyond, counters.shadow_rays)) {
            shade(exit, true, direction, vertex);
            through = 0.5f * (through + unscattered(vertex));
        }
        share *= through;
        from.inside.add(entry.key);
    }
    return 0;
}

glm::vec3 PlyScene::direct_light(const PlyVertex& vertex, const Departure& from, f32::ClothRandom random, bool first,
                                 PlyCounters& counters) const
{
    const int slots = f32::cloth_light_slots(lights_, first);
    glm::vec3 sum(0);
    for (int slot = 0; slot < slots; ++slot) {
        const f32::ClothRandom own = f32::cloth_slot_random(random, slot);
        const f32::ClothLightChoice choice =
            f32::cloth_ask_light(lights_, slot, slots, f32::cloth_draw(own, f32::cloth_dim_light).x);
        const f32::ClothDirect light = f32::cloth_direct(lights_, maps_[vertex.object], vertex.surface, vertex.shading,
                                                         point_settings, own, choice);
        if (light.any)
            sum += light.value * transmittance(from, light.wi, light.distance * (1.0f - 1e-4f), counters);
        else
            ++counters.rays_saved;
    }
    return sum;
}

glm::vec3 PlyScene::radiance(const f32::ClothRay& camera_ray, f32::ClothRandom random, int max_depth,
                             PlyCounters& counters, PlyVertex& first, bool& hit) const
{
    Departure from;
    PlyVertex seen, vertex;
    hit = find_vertex(camera_ray, random, from, counters, first, vertex);
    if (!hit) return f32::cloth_background(lights_, glm::normalize(camera_ray.direction));
    glm::vec3 radiance = direct_light(vertex, from, random, true, counters), throughput(1);
    // What shines is seen by camera rays alone: at a bounce cloth_direct has counted it.
    const int light = scene_.objects[first.object].light;
    if (light >= 0) radiance += f32::cloth_emitted(scene_.lights[std::size_t(light)], first.surface.side);
    for (int depth = 1; depth < max_depth; ++depth) {
        const f32::ClothBounce bounce =
            f32::cloth_bounce(maps_[vertex.object], vertex.surface, vertex.shading, point_settings, random, throughput);
        if (!bounce.any) break;
        throughput = bounce.throughput;
        random.offset += f32::cloth_dims_per_vertex;
        if (depth > f32::cloth_roulette_start) {
            const float survive = f32::cloth_survival(throughput);
            if (f32::cloth_draw(random, f32::cloth_dim_pixel).x >= survive) break;
            throughput /= survive;
        }
        const f32::ClothRay ray{from.origin, bounce.wi, glm::vec3(0), glm::vec3(0)};
        if (!find_vertex(ray, random, from, counters, seen, vertex)) break; // the environment: cloth_direct
        radiance += throughput * direct_light(vertex, from, random, false, counters);
    }
    return radiance;
}

} // namespace selvedge
