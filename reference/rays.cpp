// Sheets of triangles, the filter that lets shadow rays through cloth, and the preview's BVH, by Embree.
#include "reference/rays.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <tuple>

#include "bake/error.hpp"
#include "reference/embree.hpp"

namespace selvedge
{

namespace f32 = cloth::f32;

namespace
{

// What of a flat triangle of cloth is the same for every ray: tiles at its first corner and along its edges, and its
// frame from the front. A cache line.
struct alignas(64) SheetTriangle {
    glm::vec2 tile, tile_1, tile_2;
    f32::ClothFrame frame;
};

std::vector<SheetTriangle> sheet_triangles(const SceneObject& object)
{
    std::vector<SheetTriangle> sheet(object.mesh.triangles.size());
    for (std::size_t k = 0; k < sheet.size(); ++k) {
        const f32::ClothTriangle triangle = triangle_of(object, k);
        const f32::ClothFacet facet = f32::cloth_facet(triangle);
        sheet[k] = {triangle.t0, facet.dt1, facet.dt2, f32::cloth_uv_frame(facet, facet.normal)};
    }
    return sheet;
}

// A fabric that light passes through, by the objects of the scene; no triangles where the object is none.
struct Sheets {
    f32::ClothMaps maps;
    std::vector<SheetTriangle> triangles;
};

// What shadow rays carry for the filter of fabrics that light passes through. Embree's own struct comes first.
struct ShadowContext {
#if RTC_VERSION_MAJOR >= 4
    RTCRayQueryContext base;
#else
    RTCIntersectContext base;
#endif
    std::vector<CrossedSheet>* noted; // sheets that are looked at later
    const Sheets* sheets;             // of the scene, by object
    const f32::ClothSettings* settings;
    bool stops = false;                 // at the first sheet, which is noted
    ShadowRay* ray = nullptr;           // that goes on from there: its sheets are looked at now,
    const CrossedSheet* past = nullptr; // but for that one
};

// Rays that go nearly the same way are traced in packets as wide as the processor's vectors. Embree takes wider ones,
// too, but makes streams of them, which do not look at which lanes are valid and find other last bits.
template <unsigned width> struct Packet;
template <> struct Packet<8> {
    using Ray = RTCRay8;
    using RayHit = RTCRayHit8;
    static constexpr auto intersect = rtcIntersect8;
    static constexpr auto occluded = rtcOccluded8;
};
template <> struct Packet<16> {
    using Ray = RTCRay16;
    using RayHit = RTCRayHit16;
    static constexpr auto intersect = rtcIntersect16;
    static constexpr auto occluded = rtcOccluded16;
};

template <typename Rays>
void set_ray(Rays& rays, std::uint32_t k, glm::vec3 origin, glm::vec3 direction, float near, float far)
{
    rays.org_x[k] = origin.x, rays.org_y[k] = origin.y, rays.org_z[k] = origin.z;
    rays.dir_x[k] = direction.x, rays.dir_y[k] = direction.y, rays.dir_z[k] = direction.z;
    rays.tnear[k] = near;
    rays.tfar[k] = far;
    rays.time[k] = 0.0f;
    rays.mask[k] = ~0u;
    rays.id[k] = k;
    rays.flags[k] = 0;
}

// Where a ray meets a sheet, and from where in the frame of the cloth. Has what the maps say of it brought.
void find_crossing(CrossedSheet& sheet, const Sheets& of, glm::vec3 direction)
{
    const SheetTriangle& triangle = of.triangles[sheet.triangle];
    sheet.tile = triangle.tile + triangle.tile_1 * sheet.u + triangle.tile_2 * sheet.v;
    sheet.direction = f32::cloth_to_local(triangle.frame, direction);
    const glm::ivec2 spot = f32::cloth_spot_at(of.maps, sheet.tile);
    f32::cloth_prefetch_texels(of.maps, spot);
    f32::cloth_prefetch_horizons(of.maps, spot);
}

// What a ray with a roulette has left behind a sheet.
void pass(ShadowRay& ray, const Sheets& of, const CrossedSheet& sheet, const f32::ClothSettings& settings)
{
    const f32::ClothCrossing crossing = f32::cloth_crossing(of.maps, sheet.tile, sheet.direction, settings);
    ray.share.left *= crossing.share;
    ray.share = f32::cloth_shadow_roulette(ray.share, ray.least);
    if (ray.share.left <= 0.0f) return;
    ray.share.left *= f32::cloth_crossing_clears(of.maps, crossing, settings);
    ray.share = f32::cloth_shadow_roulette(ray.share, ray.least);
}

// Lets shadow rays through one sheet of cloth, or ends them there.
void cross_sheet(const RTCFilterFunctionNArguments* arguments)
{
    ShadowContext& context = *reinterpret_cast<ShadowContext*>(arguments->context);
    const unsigned count = arguments->N;
    for (unsigned k = 0; k < count; ++k) {
        if (arguments->valid[k] == 0) continue;
        CrossedSheet sheet = {RTCRayN_id(arguments->ray, count, k),
                              RTCHitN_geomID(arguments->hit, count, k),
                              RTCHitN_primID(arguments->hit, count, k),
                              RTCHitN_u(arguments->hit, count, k),
                              RTCHitN_v(arguments->hit, count, k),
                              glm::vec2(0.0f),
                              glm::vec3(0.0f)};
        const Sheets& of = context.sheets[sheet.object];
        if (context.ray) {
            const bool is_past = sheet.object == context.past->object && sheet.triangle == context.past->triangle;
            if (is_past) {
                arguments->valid[k] = 0;
                continue;
            }
            find_crossing(sheet, of, context.ray->direction);
            pass(*context.ray, of, sheet, *context.settings);
            if (context.ray->share.left <= 0.0f) continue;
        } else {
            __builtin_prefetch(of.triangles.data() + sheet.triangle);
            context.noted->push_back(sheet);
            if (context.stops) continue;
        }
        arguments->valid[k] = 0;
    }
}

} // namespace

struct RayScene::State {
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    int packet = 1; // rays that go together: as many as a vector of the processor holds, of 4 alone
    std::vector<Sheets> sheets;

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
    if (rtcGetDeviceProperty(state.device, RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED)) state.packet = 8;
    if (rtcGetDeviceProperty(state.device, RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED)) state.packet = 16;
    state.scene = rtcNewScene(state.device);
    rtcSetSceneFlags(state.scene, RTC_SCENE_FLAG_ROBUST);
    // High quality splits triangles, and then Embree may show one crossing to the filter twice, which would be counted
    // twice.
    const bool filtered = std::any_of(scene.objects.begin(), scene.objects.end(),
                                      [&](const SceneObject& object) { return lets_rays_through(scene, object); });
    rtcSetSceneBuildQuality(state.scene, filtered ? RTC_BUILD_QUALITY_MEDIUM : RTC_BUILD_QUALITY_HIGH);
    state.sheets.resize(scene.objects.size());
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
        const SceneObject& object = scene.objects[k];
        RTCGeometry geometry = new_triangles(state.device, object.mesh.positions, object.mesh.triangles);
        if (lets_rays_through(scene, object)) {
            state.sheets[k] = {maps_of(scene.fabrics[std::size_t(object.fabric)]), sheet_triangles(object)};
            rtcSetGeometryOccludedFilterFunction(geometry, cross_sheet);
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

template <unsigned width>
static void closest_in_packets(const RayScene& scene, RTCScene tree, const PencilRay* rays, std::uint32_t count,
                               RayHit* hits)
{
    constexpr float edge = 1e-4f;
    for (std::uint32_t first = 0; first < count; first += width) {
        alignas(64) int valid[width];
        alignas(64) typename Packet<width>::RayHit query;
        for (std::uint32_t k = 0; k < width; ++k) {
            const PencilRay& ray = rays[std::min(first + k, count - 1)];
            valid[k] = first + k < count ? -1 : 0;
            set_ray(query.ray, k, ray.origin, ray.direction, ray.near, std::numeric_limits<float>::infinity());
            query.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
            query.hit.primID[k] = RTC_INVALID_GEOMETRY_ID;
            query.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
        }
#if RTC_VERSION_MAJOR >= 4
        RTCIntersectArguments arguments;
        rtcInitIntersectArguments(&arguments);
        arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
        Packet<width>::intersect(valid, tree, &query, &arguments);
#else
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        Packet<width>::intersect(valid, tree, &context, &query);
#endif
        for (std::uint32_t k = 0; k < width && first + k < count; ++k) {
            RayHit& hit = hits[first + k];
            hit = {query.hit.geomID[k] != RTC_INVALID_GEOMETRY_ID, query.hit.geomID[k], query.hit.primID[k],
                   query.ray.tfar[k]};
            if (!hit.any) continue;
            // Of triangles that meet in a point the tree's order decides, which is that of the whole packet: such a ray
            // is asked for alone, so that its answer does not depend on which others it goes with.
            const float u = query.hit.u[k], v = query.hit.v[k];
            const PencilRay& ray = rays[first + k];
            if (std::min({u, v, 1.0f - u - v}) < edge)
                hit = scene.closest(ray.origin, ray.direction, ray.near, std::numeric_limits<float>::infinity());
        }
    }
}

void RayScene::closest_together(const PencilRay* rays, std::uint32_t count, RayHit* hits) const
{
    if (state_->packet == 16) return closest_in_packets<16>(*this, state_->scene, rays, count, hits);
    if (state_->packet == 8) return closest_in_packets<8>(*this, state_->scene, rays, count, hits);
    for (std::uint32_t k = 0; k < count; ++k)
        hits[k] = closest(rays[k].origin, rays[k].direction, rays[k].near, std::numeric_limits<float>::infinity());
}

namespace
{

// One shadow ray, number k: whether it is blocked.
bool is_blocked(RTCScene scene, const ShadowRay& from, std::uint32_t k, ShadowContext& context)
{
    RTCRay ray;
    ray.org_x = from.origin.x, ray.org_y = from.origin.y, ray.org_z = from.origin.z;
    ray.dir_x = from.direction.x, ray.dir_y = from.direction.y, ray.dir_z = from.direction.z;
    ray.tnear = 0.0f;
    ray.tfar = from.far;
    ray.time = 0.0f;
    ray.mask = ~0u;
    ray.id = k;
    ray.flags = 0;
#if RTC_VERSION_MAJOR >= 4
    RTCOccludedArguments arguments;
    rtcInitOccludedArguments(&arguments);
    arguments.context = &context.base;
    arguments.flags = RTC_RAY_QUERY_FLAG_INCOHERENT;
    rtcOccluded1(scene, &ray, &arguments);
#else
    context.base.flags = RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    rtcOccluded1(scene, &context.base, &ray);
#endif
    return ray.tfar < 0.0f;
}

// The first shadow rays that go together: whether they are blocked.
template <unsigned width>
void block_in_packets(RTCScene scene, ShadowRay* rays, std::uint32_t together, ShadowContext& context)
{
    for (std::uint32_t first = 0; first < together; first += width) {
        alignas(64) int valid[width];
        alignas(64) typename Packet<width>::Ray query;
        for (std::uint32_t k = 0; k < width; ++k) {
            const std::uint32_t at = std::min(first + k, together - 1);
            valid[k] = first + k < together ? -1 : 0;
            set_ray(query, k, rays[at].origin, rays[at].direction, 0.0f, rays[at].far);
            query.id[k] = at;
        }
#if RTC_VERSION_MAJOR >= 4
        RTCOccludedArguments arguments;
        rtcInitOccludedArguments(&arguments);
        arguments.context = &context.base;
        arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
        Packet<width>::occluded(valid, scene, &query, &arguments);
#else
        context.base.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        Packet<width>::occluded(valid, scene, &context.base, &query);
#endif
        for (std::uint32_t k = 0; k < width && first + k < together; ++k)
            if (query.tfar[k] < 0.0f) rays[first + k].share.left = 0.0f;
    }
}

} // namespace

void RayScene::find_transmittances(ShadowRay* rays, std::uint32_t together, std::uint32_t count,
                                   const f32::ClothSettings& settings, std::vector<CrossedSheet>& sheets) const
{
    ShadowContext context;
    context.noted = &sheets;
    context.sheets = state_->sheets.data();
    context.settings = &settings;
#if RTC_VERSION_MAJOR >= 4
    rtcInitRayQueryContext(&context.base);
#else
    rtcInitIntersectContext(&context.base);
#endif

    // Rays with a roulette end at the first sheet, most for good. Those that it lets through set out again.
    sheets.clear();
    context.stops = true;
    for (std::uint32_t k = together; k < count; ++k) {
        if (rays[k].least <= 0.0f) continue;
        const std::size_t before = sheets.size();
        if (is_blocked(state_->scene, rays[k], k, context) && sheets.size() == before) rays[k].share.left = 0.0f;
    }
    context.stops = false;
    for (CrossedSheet& sheet : sheets) find_crossing(sheet, state_->sheets[sheet.object], rays[sheet.ray].direction);
    for (const CrossedSheet& sheet : sheets) {
        ShadowRay& ray = rays[sheet.ray];
        pass(ray, state_->sheets[sheet.object], sheet, settings);
        if (ray.share.left <= 0.0f) continue;
        context.ray = &ray;
        context.past = &sheet;
        if (is_blocked(state_->scene, ray, sheet.ray, context)) ray.share.left = 0.0f;
    }
    context.ray = nullptr;

    sheets.clear();
    if (state_->packet == 16) block_in_packets<16>(state_->scene, rays, together, context);
    if (state_->packet == 8) block_in_packets<8>(state_->scene, rays, together, context);
    for (std::uint32_t k = state_->packet > 1 ? together : 0; k < count; ++k) {
        if (rays[k].least > 0.0f) continue;
        const std::size_t before = sheets.size();
        if (!is_blocked(state_->scene, rays[k], k, context)) continue;
        sheets.resize(before);
        rays[k].share.left = 0.0f;
    }
    if (sheets.empty()) return;

    // Rays that are blocked need no share. A product is the same bits in one order only: that of the triangles.
    std::erase_if(sheets, [&](const CrossedSheet& sheet) { return rays[sheet.ray].share.left <= 0.0f; });
    std::sort(sheets.begin(), sheets.end(), [](const CrossedSheet& a, const CrossedSheet& b) {
        return std::tie(a.ray, a.object, a.triangle) < std::tie(b.ray, b.object, b.triangle);
    });
    // Embree shows a crossing of a ray in a packet of 8 more than once, now and then.
    const auto last = std::unique(sheets.begin(), sheets.end(), [](const CrossedSheet& a, const CrossedSheet& b) {
        return a.ray == b.ray && a.object == b.object && a.triangle == b.triangle;
    });
    sheets.erase(last, sheets.end());
    for (CrossedSheet& sheet : sheets) find_crossing(sheet, state_->sheets[sheet.object], rays[sheet.ray].direction);
    for (const CrossedSheet& sheet : sheets)
        rays[sheet.ray].share.left *=
            f32::cloth_transmittance(state_->sheets[sheet.object].maps, sheet.tile, sheet.direction, settings);
}

float RayScene::transmittance(glm::vec3 origin, glm::vec3 direction, float far,
                              const f32::ClothSettings& settings) const
{
    ShadowRay ray{origin, direction, far, 0.0f, {1.0f, 0.0f}};
    std::vector<CrossedSheet> sheets;
    find_transmittances(&ray, 0, 1, settings, sheets);
    return ray.share.left;
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

namespace
{

// Of a box's nearest point; boxes that overlap there are told apart by their middles.
float distance_to(const BvhNode& node, glm::vec3 eye)
{
    return glm::distance(glm::clamp(eye, node.low, node.high), eye) +
           0.5f * glm::distance(0.5f * (node.low + node.high), eye);
}

void append_ordered(const std::vector<BvhNode>& from, std::uint32_t at, glm::vec3 eye, std::vector<BvhNode>& to)
{
    const std::size_t place = to.size();
    to.push_back(from[at]);
    if (from[at].leaf == 0) {
        std::uint32_t first = at + 1, second = from[first].skip;
        const bool two = second < from[at].skip;
        if (two && distance_to(from[second], eye) < distance_to(from[first], eye)) std::swap(first, second);
        append_ordered(from, first, eye, to);
        if (two) append_ordered(from, second, eye, to);
    }
    to[place].skip = std::uint32_t(to.size());
}

} // namespace

void order_bvh(Bvh& bvh, glm::vec3 eye)
{
    if (bvh.nodes.empty()) return;
    std::vector<BvhNode> ordered;
    ordered.reserve(bvh.nodes.size());
    append_ordered(bvh.nodes, 0, eye, ordered);
    bvh.nodes = std::move(ordered);
}

std::string embree_version()
{
    return RTC_VERSION_STRING;
}

} // namespace selvedge
