// Sheets of triangles, the filter that lets shadow rays through cloth, and the preview's BVH, by Embree.
#include "reference/rays.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "bake/error.hpp"
#include "reference/embree.hpp"

namespace selvedge
{

namespace f32 = cloth::f32;

namespace
{

// What a shadow ray carries for the filter of fabrics with gaps. Embree's own struct comes first.
struct ShadowContext {
#if RTC_VERSION_MAJOR >= 4
    RTCRayQueryContext base;
#else
    RTCIntersectContext base;
#endif
    f32::ClothSettings settings;
    float transmittance; // of the sheets passed so far
};

// What the filter knows about its geometry: the fabric, and what of a triangle is the same for every ray.
struct FilterTarget {
    const SceneObject* object;
    f32::ClothMaps maps;
    std::vector<f32::ClothFrame> frames; // of the flat triangles, from their front
};

std::vector<f32::ClothFrame> flat_frames(const SceneObject& object)
{
    std::vector<f32::ClothFrame> frames(object.mesh.triangles.size());
    for (std::size_t k = 0; k < frames.size(); ++k) {
        const f32::ClothTriangle triangle = triangle_of(object, k);
        const glm::vec3 n = glm::cross(triangle.p1 - triangle.p0, triangle.p2 - triangle.p0);
        const glm::vec3 n_g = f32::cloth_unit_vector(
            n * (1.0f / std::max({std::abs(n.x), std::abs(n.y), std::abs(n.z), 1e-30f})), glm::vec3(0.0f, 0.0f, 1.0f));
        frames[k] = f32::cloth_uv_frame(triangle, n_g, n_g);
    }
    return frames;
}

// Lets a shadow ray through one sheet of cloth, less what the sheet keeps. Called for single rays only.
void pass_cloth(const RTCFilterFunctionNArguments* arguments)
{
    if (arguments->valid[0] == 0) return;
    const FilterTarget& target = *static_cast<const FilterTarget*>(arguments->geometryUserPtr);
    ShadowContext& context = *reinterpret_cast<ShadowContext*>(arguments->context);
    const std::uint32_t primitive = RTCHitN_primID(arguments->hit, 1, 0);
    const float u = RTCHitN_u(arguments->hit, 1, 0), v = RTCHitN_v(arguments->hit, 1, 0);
    const glm::vec3 direction(RTCRayN_dir_x(arguments->ray, 1, 0), RTCRayN_dir_y(arguments->ray, 1, 0),
                              RTCRayN_dir_z(arguments->ray, 1, 0));

    const glm::vec2* corners = target.object->mesh.corner_tiles.data() + 3 * std::size_t(primitive);
    const glm::vec2 tile = corners[0] + (corners[1] - corners[0]) * u + (corners[2] - corners[0]) * v;
    const float share = f32::cloth_transmittance(
        target.maps, tile, f32::cloth_to_local(target.frames[primitive], direction), context.settings);
    if (share <= 0.0f) return;
    context.transmittance *= share;
    arguments->valid[0] = 0;
}

} // namespace

struct RayScene::State {
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    std::vector<FilterTarget> targets;

    ~State()
    {
        if (scene) rtcReleaseScene(scene);
        if (device) rtcReleaseDevice(device);
    }
};

RayScene::RayScene(const Scene& scene) : state_(std::make_unique<State>())
{
    State& state = *state_;
    state.device = new_device();
    state.scene = rtcNewScene(state.device);
    rtcSetSceneFlags(state.scene, RTC_SCENE_FLAG_ROBUST);
    // High quality splits triangles, and then Embree may show one crossing to the filter twice, which would be counted
    // twice.
    const bool filtered = std::any_of(scene.objects.begin(), scene.objects.end(),
                                      [&](const SceneObject& object) { return lets_rays_through(scene, object); });
    rtcSetSceneBuildQuality(state.scene, filtered ? RTC_BUILD_QUALITY_MEDIUM : RTC_BUILD_QUALITY_HIGH);
    state.targets.reserve(scene.objects.size());
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
        const SceneObject& object = scene.objects[k];
        RTCGeometry geometry = new_triangles(state.device, object.mesh.positions, object.mesh.triangles);
        if (lets_rays_through(scene, object)) {
            state.targets.push_back({&object, maps_of(scene.fabrics[std::size_t(object.fabric)]), flat_frames(object)});
            rtcSetGeometryUserData(geometry, &state.targets.back());
            rtcSetGeometryOccludedFilterFunction(geometry, pass_cloth);
            ++needs_.filtered_objects;
        }
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(state.scene, geometry, unsigned(k));
        rtcReleaseGeometry(geometry);
        needs_.triangles += object.mesh.triangles.size();
        ++needs_.objects;
    }
    commit_alone(state.scene);
    throw_on_error(state.device);
}

RayScene::~RayScene() = default;

RayHit RayScene::closest(glm::vec3 origin, glm::vec3 direction, float near, float far) const
{
    const RTCRayHit query = first_hit(state_->scene, origin, direction, near, far);
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
    return {true, query.hit.geomID, query.hit.primID, query.ray.tfar};
}

float RayScene::transmittance(glm::vec3 origin, glm::vec3 direction, float far,
                              const f32::ClothSettings& settings) const
{
    RTCRay ray;
    ray.org_x = origin.x, ray.org_y = origin.y, ray.org_z = origin.z;
    ray.dir_x = direction.x, ray.dir_y = direction.y, ray.dir_z = direction.z;
    ray.tnear = 0.0f;
    ray.tfar = far;
    ray.time = 0.0f;
    ray.mask = ~0u;
    ray.id = 0;
    ray.flags = 0;
    ShadowContext context;
    context.settings = settings;
    context.transmittance = 1.0f;
#if RTC_VERSION_MAJOR >= 4
    rtcInitRayQueryContext(&context.base);
    RTCOccludedArguments arguments;
    rtcInitOccludedArguments(&arguments);
    arguments.context = &context.base;
    rtcOccluded1(state_->scene, &ray, &arguments);
#else
    rtcInitIntersectContext(&context.base);
    rtcOccluded1(state_->scene, &context.base, &ray);
#endif
    return ray.tfar < 0.0f ? 0.0f : context.transmittance;
}

// ---- the preview's BVH
// -----------------------------------------------------------------------------------------------------

namespace
{

struct BuildNode {
    RTCBounds bounds[2];
    BuildNode* children[2] = {nullptr, nullptr}; // both null: a leaf
    std::uint32_t count = 0;
    glm::uvec2 triangles[4];
};

constexpr std::size_t leaf_size = 4;

void* create_node(RTCThreadLocalAllocator allocator, unsigned, void*)
{
    return new (rtcThreadLocalAlloc(allocator, sizeof(BuildNode), 16)) BuildNode;
}

void set_children(void* node, void** children, unsigned count, void*)
{
    for (unsigned k = 0; k < count && k < 2; ++k)
        static_cast<BuildNode*>(node)->children[k] = static_cast<BuildNode*>(children[k]);
}

void set_bounds(void* node, const RTCBounds** bounds, unsigned count, void*)
{
    for (unsigned k = 0; k < count && k < 2; ++k) static_cast<BuildNode*>(node)->bounds[k] = *bounds[k];
}

void* create_leaf(RTCThreadLocalAllocator allocator, const RTCBuildPrimitive* primitives, std::size_t count, void*)
{
    BuildNode* leaf = new (rtcThreadLocalAlloc(allocator, sizeof(BuildNode), 16)) BuildNode;
    leaf->count = std::uint32_t(count);
    for (std::size_t k = 0; k < count; ++k) leaf->triangles[k] = {primitives[k].geomID, primitives[k].primID};
    return leaf;
}

// Depth first, so that a node's first child follows it; returns nothing, fills skip on the way back.
void flatten(Bvh& bvh, const BuildNode& node, const RTCBounds& bounds)
{
    const std::size_t at = bvh.nodes.size();
    bvh.nodes.push_back(
        {{bounds.lower_x, bounds.lower_y, bounds.lower_z}, 0, {bounds.upper_x, bounds.upper_y, bounds.upper_z}, 0});
    if (node.count > 0) {
        bvh.nodes[at].leaf = std::uint32_t(bvh.triangles.size() * 8) + node.count;
        bvh.triangles.insert(bvh.triangles.end(), node.triangles, node.triangles + node.count);
    } else {
        for (int k = 0; k < 2; ++k)
            if (node.children[k]) flatten(bvh, *node.children[k], node.bounds[k]);
    }
    bvh.nodes[at].skip = std::uint32_t(bvh.nodes.size());
}

} // namespace

Bvh build_bvh(const Scene& scene)
{
    std::size_t count = 0;
    for (const SceneObject& object : scene.objects) count += object.mesh.triangles.size();
    if (count >= std::size_t(1) << 29)
        throw InputError("", 0, "found %zu triangles in the scene, expected less than 2^29", count);
    Bvh bvh;
    if (count == 0) return bvh;

    // Spatial splits want room for duplicates; without the split callback high quality means a full SAH sweep.
    std::vector<RTCBuildPrimitive> primitives;
    primitives.reserve(count);
    RTCBounds all{INFINITY, INFINITY, INFINITY, 0.0f, -INFINITY, -INFINITY, -INFINITY, 0.0f};
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
        const Mesh& mesh = scene.objects[k].mesh;
        for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
            const glm::uvec3 i = mesh.triangles[t];
            const glm::vec3 a = mesh.positions[i.x], b = mesh.positions[i.y], c = mesh.positions[i.z];
            const glm::vec3 low = glm::min(a, glm::min(b, c)), high = glm::max(a, glm::max(b, c));
            primitives.push_back({low.x, low.y, low.z, unsigned(k), high.x, high.y, high.z, unsigned(t)});
            all.lower_x = std::min(all.lower_x, low.x), all.upper_x = std::max(all.upper_x, high.x);
            all.lower_y = std::min(all.lower_y, low.y), all.upper_y = std::max(all.upper_y, high.y);
            all.lower_z = std::min(all.lower_z, low.z), all.upper_z = std::max(all.upper_z, high.z);
        }
    }

    RTCDevice device = new_device();
    RTCBVH tree = rtcNewBVH(device);
    RTCBuildArguments arguments = rtcDefaultBuildArguments();
    arguments.buildQuality = RTC_BUILD_QUALITY_MEDIUM;
    arguments.maxBranchingFactor = 2;
    arguments.maxDepth = 64;
    arguments.maxLeafSize = leaf_size;
    arguments.bvh = tree;
    arguments.primitives = primitives.data();
    arguments.primitiveCount = primitives.size();
    arguments.primitiveArrayCapacity = primitives.size();
    arguments.createNode = create_node;
    arguments.setNodeChildren = set_children;
    arguments.setNodeBounds = set_bounds;
    arguments.createLeaf = create_leaf;
    const void* root = rtcBuildBVH(&arguments);
    const RTCError code = rtcGetDeviceError(device);
    if (root && code == RTC_ERROR_NONE) {
        bvh.nodes.reserve(count);
        bvh.triangles.reserve(count);
        flatten(bvh, *static_cast<const BuildNode*>(root), all);
    }
    rtcReleaseBVH(tree);
    rtcReleaseDevice(device);
    if (bvh.nodes.empty()) throw std::runtime_error(format_text("Embree does not build a BVH (error %d)", int(code)));
    return bvh;
}

std::string embree_version()
{
    return RTC_VERSION_STRING;
}

} // namespace selvedge
