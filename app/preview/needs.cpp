// app/preview/needs.cpp: which parts of the shading a scene needs.
#include "app/preview/needs.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace selvedge
{

using namespace cloth::f32;

namespace
{

constexpr std::size_t tests_limit = std::size_t(1) << 26;

// Distances up to this share of the scene's extent are rounding: below what cloth_leave lifts a ray off its surface.
constexpr double flat = 1e-6;

struct Plane {
    glm::dvec3 normal; // unit
    double offset;
};

// Neighbours in the list of vertices and the box around them: most planes are far from most boxes.
struct Cluster {
    glm::dvec3 low{1e300}, high{-1e300};
    const glm::vec3* first = nullptr;
    std::size_t count = 0;
};
constexpr std::size_t cluster_size = 64;

std::vector<Cluster> clusters_of(const Scene& scene)
{
    std::vector<Cluster> clusters;
    for (const SceneObject& object : scene.objects)
        for (std::size_t first = 0; first < object.mesh.positions.size(); first += cluster_size) {
            Cluster cluster;
            cluster.first = object.mesh.positions.data() + first;
            cluster.count = std::min(cluster_size, object.mesh.positions.size() - first);
            for (std::size_t k = 0; k < cluster.count; ++k) {
                cluster.low = glm::min(cluster.low, glm::dvec3(cluster.first[k]));
                cluster.high = glm::max(cluster.high, glm::dvec3(cluster.first[k]));
            }
            clusters.push_back(cluster);
        }
    return clusters;
}

// Most that a point of the box lies in front of a plane.
double in_front(const Plane& plane, glm::dvec3 low, glm::dvec3 high)
{
    const glm::dvec3 corner = glm::mix(low, high, glm::greaterThan(plane.normal, glm::dvec3(0)));
    return glm::dot(plane.normal, corner) - plane.offset;
}

std::vector<Plane> planes_of(const Scene& scene)
{
    std::vector<Plane> planes;
    for (const SceneObject& object : scene.objects)
        for (const glm::uvec3& t : object.mesh.triangles) {
            const glm::dvec3 a = object.mesh.positions[t.x];
            const glm::dvec3 n =
                glm::cross(glm::dvec3(object.mesh.positions[t.y]) - a, glm::dvec3(object.mesh.positions[t.z]) - a);
            const double length = glm::length(n);
            if (length > 0) planes.push_back({n / length, glm::dot(n / length, a)});
        }
    return planes;
}

// Every directed edge has its opposite, corners compared by position: vertices are split where normals differ.
bool is_closed(const Scene& scene)
{
    std::map<std::array<float, 3>, std::size_t> number;
    std::map<std::pair<std::size_t, std::size_t>, int> edges;
    for (const SceneObject& object : scene.objects)
        for (const glm::uvec3& t : object.mesh.triangles) {
            std::size_t corner[3];
            for (int k = 0; k < 3; ++k) {
                const glm::vec3 p = object.mesh.positions[t[k]];
                corner[k] = number.try_emplace({p.x, p.y, p.z}, number.size()).first->second;
            }
            for (int k = 0; k < 3; ++k) {
                const std::size_t from = corner[k], to = corner[(k + 1) % 3];
                if (from == to) continue;
                if (from < to)
                    ++edges[{from, to}];
                else
                    --edges[{to, from}];
            }
        }
    return std::all_of(edges.begin(), edges.end(), [](const auto& edge) { return edge.second == 0; });
}

} // namespace

BlockingShape blocking_shape(const Scene& scene)
{
    BlockingShape shape;
    const std::vector<Plane> planes = planes_of(scene);
    if (planes.empty()) {
        shape.planar = shape.convex = true;
        return shape;
    }
    const std::vector<Cluster> clusters = clusters_of(scene);
    Cluster all;
    for (const Cluster& cluster : clusters) {
        all.low = glm::min(all.low, cluster.low);
        all.high = glm::max(all.high, cluster.high);
    }
    const double tolerance = flat * glm::length(all.high - all.low);
    const auto within = [&](const Plane& plane) {
        return std::all_of(clusters.begin(), clusters.end(), [&](const Cluster& cluster) {
            return in_front(plane, cluster.low, cluster.high) <= tolerance ||
                   std::all_of(cluster.first, cluster.first + cluster.count, [&](const glm::vec3& p) {
                       return glm::dot(plane.normal, glm::dvec3(p)) - plane.offset <= tolerance;
                   });
        });
    };
    const Plane& one = planes.front();
    if (within(one) && within({-one.normal, -one.offset})) {
        shape.planar = shape.convex = true;
        return shape;
    }
    // At the first vertex in front of a plane it is over, which in most scenes is soon.
    if (planes.size() * clusters.size() > tests_limit || !std::all_of(planes.begin(), planes.end(), within)) return {};
    shape.convex = true;
    shape.closed = is_closed(scene);
    return shape;
}

static bool in_front_of_any(const Scene& scene, glm::dvec3 point)
{
    const std::vector<Plane> planes = planes_of(scene);
    return std::any_of(planes.begin(), planes.end(),
                       [&](const Plane& plane) { return glm::dot(plane.normal, point) > plane.offset; });
}

const std::vector<std::string>& skip_names()
{
    static const std::vector<std::string> names = {"bounces", "emitters", "fabric", "gaps",  "interreflection",
                                                   "lights",  "matte",    "metal",  "model", "noise",
                                                   "search",  "shadows",  "stacks", "unseen"};
    return names;
}

Needs Needs::of(const Scene& scene, const BlockingShape& shape, const CameraSpec& camera, int footprint_samples,
                int max_depth, const std::set<std::string>& kept)
{
    Needs needs;
    const auto left_out = [&](const char* name, bool possible) {
        return needs.skipped[name] = possible && kept.count(name) == 0;
    };
    bool any_fabric = false, any_gaps = false, any_matte = false, any_metal = false, any_emitter = false;
    bool all_gaps = true; // of the fabrics
    for (const SceneObject& object : scene.objects) {
        (object.fabric >= 0 ? any_fabric : any_matte) = true;
        any_gaps |= lets_rays_through(scene, object);
        all_gaps &= object.fabric < 0 || lets_rays_through(scene, object);
        any_metal |= object.roughness > 0;
        any_emitter |= object.light >= 0;
    }
    needs.fabric = !left_out("fabric", !any_fabric);
    needs.matte = !left_out("matte", !any_matte);
    needs.metal = !left_out("metal", !any_metal);
    needs.emitters = !left_out("emitters", !any_emitter);
    needs.gaps = !left_out("gaps", !any_gaps);
    needs.several_points = footprint_samples > 1;

    needs.model = scene.model.settings;
    const auto every_fabric = [&](auto&& is_so) {
        return std::all_of(scene.fabrics.begin(), scene.fabrics.end(), is_so);
    };
    if (left_out("noise", every_fabric([](const PackedFabric& f) { return f.noise_amplitude <= 0; })))
        needs.model.twist_noise = false;
    // A lobe of albedo 0.
    const auto gives_nothing = [](const ClothYarn& y) {
        return y.reflectance == glm::vec3(0) && y.transmittance == glm::vec3(0);
    };
    if (left_out("interreflection", every_fabric([&](const PackedFabric& f) {
                     return std::all_of(f.yarns.begin(), f.yarns.end(), gives_nothing);
                 })))
        needs.model.interreflection = false;
    // No second lobe of what passes, where no two yarns lie over each other or nothing passes them bent.
    const auto bends_nothing = [](const ClothYarn& y) { return y.beneath <= 0 || y.albedo_t == glm::vec3(0); };
    needs.stacks = !left_out("stacks", every_fabric([&](const PackedFabric& f) {
                                 return std::all_of(f.yarns.begin(), f.yarns.end(), bends_nothing);
                             }));
    needs.compiled_model = left_out("model", true);
    // A second search for the points that the rasteriser has found: where it has found all. Two words have no room
    // for areas.
    const bool handed_over =
        any_fabric && all_gaps && needs.gaps && !needs.layers() && !cloth_weighs_areas(needs.model);
    needs.found = left_out("search", handed_over);
    needs.seen = left_out("unseen", true);

    for (const ClothLight& light : scene.lights) needs.light_kinds |= 1 << light.kind;
    constexpr int all_kinds = (2 << cloth_light_mesh) - 1;
    const bool few = scene.lights.size() <= std::size_t(cloth_lights_asked);
    if (left_out("lights", needs.light_kinds != all_kinds || few)) {
        if (few) needs.light_count = static_cast<int>(scene.lights.size());
        needs.sky = scene.lights.size() > 1 && scene.lights[0].kind == cloth_light_environment;
        const auto is_as_second = [&](const ClothLight& light) { return light.kind == scene.lights[1].kind; };
        if (needs.sky && std::all_of(scene.lights.begin() + 1, scene.lights.end(), is_as_second))
            needs.other_lights = scene.lights[1].kind;
    } else {
        needs.light_kinds = all_kinds;
    }

    // Light leaves matte on the viewer's side alone; cloth sends it through to the other side as well.
    const bool fronts_alone = !any_fabric && shape.convex && shape.closed && camera.lens_radius == 0 &&
                              in_front_of_any(scene, camera.position);
    needs.shadows = shape.planar || fronts_alone ? ShadowNeed::none
                    : shape.convex               ? ShadowNeed::inward
                                                 : ShadowNeed::all;
    // Where nothing is in the way of any light that leaves a surface, that light meets no second one.
    const bool paths = max_depth > 1;
    needs.bounces = paths && !left_out("bounces", needs.shadows == ShadowNeed::none);
    if (!left_out("shadows", needs.shadows != ShadowNeed::all)) needs.shadows = ShadowNeed::all;
    return needs;
}

std::vector<std::string> Needs::model_defines() const
{
    const std::pair<const char*, std::pair<int, const char*>> rows[] = {
        {"MODEL_BSDF", {model.bsdf, "frame.model.x"}},
        {"MODEL_WEIGHT", {model.weight, "frame.model.y"}},
        {"MODEL_VISIBILITY", {model.visibility, "frame.model.z"}},
        {"MODEL_SLAB", {model.slab, "frame.model.w"}},
        {"MODEL_UNSCATTERED", {model.unscattered, "frame.ingredients.x"}},
        {"MODEL_INTERREFLECTION", {model.interreflection, "frame.ingredients.y"}},
        {"MODEL_TWIST_NOISE", {model.twist_noise, "frame.ingredients.z"}}};
    std::vector<std::string> defines;
    for (const auto& [name, value] : rows)
        defines.push_back(std::string(name) + " " + (compiled_model ? std::to_string(value.first) : value.second));
    return defines;
}

std::vector<std::string> Needs::light_defines() const
{
    std::vector<std::string> list = model_defines();
    list.push_back("CLOTH_LIGHT_KINDS " + std::to_string(light_kinds));
    list.push_back("LIGHT_COUNT " + std::to_string(light_count));
    if (light_count >= 0) list.emplace_back("FEW_LIGHTS");
    return list;
}

std::vector<std::string> Needs::defines() const
{
    std::vector<std::string> list = light_defines();
    list.push_back(metal ? "CLOTH_METAL 1" : "CLOTH_METAL 0");
    list.push_back(stacks ? "CLOTH_STACKS 1" : "CLOTH_STACKS 0");
    list.push_back("OTHER_LIGHTS " + std::to_string(other_lights));
    const std::pair<const char*, bool> parts[] = {{"FABRIC", fabric},
                                                  {"GAPS", gaps},
                                                  {"FOOTPRINT", several_points},
                                                  {"LAYERS", layers()},
                                                  {"FOUND", found && !camera_rays},
                                                  {"CAMERA_RAYS", camera_rays},
                                                  {"MATTE", matte},
                                                  {"EMITTERS", emitters},
                                                  {"SKY", sky},
                                                  {"SHADOWS", shadows != ShadowNeed::none},
                                                  {"CONVEX", shadows == ShadowNeed::inward},
                                                  {"BOUNCES", bounces}};
    for (const auto& [name, needed] : parts)
        if (needed) list.emplace_back(name);
    return list;
}

} // namespace selvedge
