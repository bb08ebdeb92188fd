// Embree, for the two files that trace: version 4 where its headers are, else 3.13; what both do alike.
#pragma once

#include <vector>

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif
#include <glm/glm.hpp>

namespace selvedge
{

// The environment variable SELVEDGE_ISA takes vectors from it: with avx2 it has none of 16 floats, with sse4.2 none
// of 8.
//   throws  std::runtime_error where Embree does not start
RTCDevice new_device();

//   throws  std::bad_alloc, std::runtime_error: what the device has met since it was last asked
void throw_on_error(RTCDevice device);

// A copy of the triangles, not committed yet. Errors as throw_on_error.
RTCGeometry new_triangles(RTCDevice device, const std::vector<glm::vec3>& positions,
                          const std::vector<glm::uvec3>& triangles);

// Builds on one thread: the order of equal hits in the tree, and with it the last bits of a picture, must not depend on
// how many cores there are.
void commit_alone(RTCScene scene);

// The first hit in [near, far], in lengths of `direction`. hit.geomID is RTC_INVALID_GEOMETRY_ID where there is none.
inline RTCRayHit first_hit(RTCScene scene, glm::vec3 origin, glm::vec3 direction, float near, float far)
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
    query.hit.primID = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(scene, &query);
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene, &context, &query);
#endif
    return query;
}

} // namespace selvedge
