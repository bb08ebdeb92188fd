// Embree's instances behind one door. rays.cpp has the other door to Embree; the two share nothing but the library.
#include "reference/rays_plies.hpp"

#include <cstring>
#include <new>
#include <stdexcept>

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif
#include <tbb/task_arena.h>

#include "bake/error.hpp"

namespace selvedge
{

namespace
{

void throw_on_error(RTCDevice device)
{
    const RTCError code = rtcGetDeviceError(device);
    if (code == RTC_ERROR_OUT_OF_MEMORY) throw std::bad_alloc();
    if (code != RTC_ERROR_NONE) throw std::runtime_error(format_text("Embree: error %d", int(code)));
}

// A tree may be built by one thread alone, so that the order of equal hits does not depend on how many there are.
void commit(RTCScene scene)
{
    tbb::task_arena arena(1);
    arena.execute([&] { rtcJoinCommitScene(scene); });
}

} // namespace

struct InstancedRays::State {
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    std::vector<RTCScene> prototypes;

    ~State()
    {
        if (scene) rtcReleaseScene(scene);
        for (RTCScene prototype : prototypes) rtcReleaseScene(prototype);
        if (device) rtcReleaseDevice(device);
    }
};

InstancedRays::InstancedRays(const std::vector<InstancedMesh>& meshes, const std::vector<Instance>& instances)
    : state_(std::make_unique<State>())
{
    State& state = *state_;
    state.device = rtcNewDevice(nullptr);
    if (!state.device)
        throw std::runtime_error(format_text("Embree does not start (error %d)", int(rtcGetDeviceError(nullptr))));
    for (const InstancedMesh& mesh : meshes) {
        RTCScene prototype = rtcNewScene(state.device);
        state.prototypes.push_back(prototype);
        rtcSetSceneFlags(prototype, RTC_SCENE_FLAG_ROBUST);
        // High quality would split triangles; a crossing is counted, so it must not be seen twice.
        rtcSetSceneBuildQuality(prototype, RTC_BUILD_QUALITY_MEDIUM);
        RTCGeometry geometry = rtcNewGeometry(state.device, RTC_GEOMETRY_TYPE_TRIANGLE);
        void* vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                 sizeof(glm::vec3), mesh.positions.size());
        void* indices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                sizeof(glm::uvec3), mesh.triangles.size());
        throw_on_error(state.device);
        std::memcpy(vertices, mesh.positions.data(), mesh.positions.size() * sizeof(glm::vec3));
        std::memcpy(indices, mesh.triangles.data(), mesh.triangles.size() * sizeof(glm::uvec3));
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(prototype, geometry);
        rtcReleaseGeometry(geometry);
        commit(prototype);
    }
    state.scene = rtcNewScene(state.device);
    rtcSetSceneFlags(state.scene, RTC_SCENE_FLAG_ROBUST);
    for (std::size_t k = 0; k < instances.size(); ++k) {
        RTCGeometry geometry = rtcNewGeometry(state.device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(geometry, state.prototypes[instances[k].mesh]);
        rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, &instances[k].to_world[0][0]);
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(state.scene, geometry, unsigned(k));
        rtcReleaseGeometry(geometry);
    }
    commit(state.scene);
    throw_on_error(state.device);
}

InstancedRays::~InstancedRays() = default;

InstancedRays::Hit InstancedRays::closest(glm::vec3 origin, glm::vec3 direction, float near, float far) const
{
    RTCRayHit query;
    query.ray.org_x = origin.x, query.ray.org_y = origin.y, query.ray.org_z = origin.z;
    query.ray.dir_x = direction.x, query.ray.dir_y = direction.y, query.ray.dir_z = direction.z;
    query.ray.tnear = near;
    query.ray.tfar = far;
    query.ray.time = 0.0f;
    query.ray.mask = ~0u;
    query.ray.id = 0;
    query.ray.flags = 0;
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(state_->scene, &query);
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(state_->scene, &context, &query);
#endif
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
    return {true, query.hit.instID[0], query.hit.primID, query.hit.u, query.hit.v, query.ray.tfar};
}

} // namespace selvedge
