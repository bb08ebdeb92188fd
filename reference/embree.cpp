// reference/embree.cpp: devices, errors, triangles, builds.
#include "reference/embree.hpp"

#include <cstdlib>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>

#include <tbb/task_arena.h>

#include "bake/error.hpp"

namespace selvedge
{

RTCDevice new_device()
{
    std::string config;
    if (const char* wanted = std::getenv("SELVEDGE_ISA"); wanted && *wanted) {
        // Embree takes any other word for its least.
        for (const char* isa : {"sse4.2", "avx", "avx2", "avx512"})
            if (std::strcmp(wanted, isa) == 0) config = std::string("isa=") + isa;
        if (config.empty())
            throw std::runtime_error(
                format_text("SELVEDGE_ISA: found '%s', expected sse4.2, avx, avx2 or avx512", wanted));
    }
    RTCDevice device = rtcNewDevice(config.empty() ? nullptr : config.c_str());
    if (!device)
        throw std::runtime_error(format_text("Embree does not start (error %d)", int(rtcGetDeviceError(nullptr))));
    return device;
}

void throw_on_error(RTCDevice device)
{
    const RTCError code = rtcGetDeviceError(device);
    if (code == RTC_ERROR_OUT_OF_MEMORY) throw std::bad_alloc();
    if (code != RTC_ERROR_NONE) throw std::runtime_error(format_text("Embree: error %d", int(code)));
}

RTCGeometry new_triangles(RTCDevice device, const std::vector<glm::vec3>& positions,
                          const std::vector<glm::uvec3>& triangles)
{
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    void* vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(glm::vec3),
                                             positions.size());
    void* indices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, sizeof(glm::uvec3),
                                            triangles.size());
    throw_on_error(device);
    std::memcpy(vertices, positions.data(), positions.size() * sizeof(glm::vec3));
    std::memcpy(indices, triangles.data(), triangles.size() * sizeof(glm::uvec3));
    return geometry;
}

void commit_alone(RTCScene scene)
{
    tbb::task_arena arena(1);
    arena.execute([&] { rtcJoinCommitScene(scene); });
}

} // namespace selvedge
