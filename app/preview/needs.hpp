// app/preview/needs.hpp: what a scene needs of the preview; everything else is left out of shaders, buffers and passes.
// Included by scene_buffers.hpp, passes.hpp and preview.hpp; needs no GL.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "reference/scene.hpp"

namespace selvedge
{

// What a mesh, or all meshes of a scene together, block of the light that leaves them.
struct BlockingShape {
    bool planar = false; // all in one plane: nothing is ever in the way
    bool convex = false; // no point is in front of any triangle: nothing is in the way in front of a triangle
    bool closed = false; // every edge belongs to two triangles that turn the same way around
};

// All triangles of the scene as one shape. Convexity is proved by the definition, every vertex against every plane
// (boxes of vertices where that is enough), and not claimed (all false) where it would take more than 2^26 tests of
// boxes.
BlockingShape blocking_shape(const Scene& scene);

// Which light may be blocked: none; what leaves a triangle backward (into a convex body); all.
enum class ShadowNeed { none, inward, all };

// The names by which the parts that can be left out are reported, and kept for comparison.
const std::vector<std::string>& skip_names();

struct Needs {
    bool fabric = false, gaps = false, matte = false;
    bool stacks = false;                  // yarns that lie over each other and bend light on its way through
    bool metal = false, emitters = false; // of objects without fabric
    bool several_points = false;          // shaded points of a pixel in a frame
    bool found = false;                   // the rasteriser hands over a point of every fabric that it sees
    bool seen = false;                    // pixels that see nothing are not shaded, and rays walk what they may meet
    bool compiled_model = true; // the model's settings are constants of the shader, not numbers in the frame's block
    int light_kinds = 0;        // bits 1 << kind
    int light_count = -1;       // of few lights, none of which has to be chosen; -1: not known to the shader
    bool sky = false;           // the first of several lights is an environment
    int other_lights = -1;      // kind of all others, -1: of more than one
    cloth::f32::ClothSettings model{};
    ShadowNeed shadows = ShadowNeed::all;
    bool bounces = false;                // paths go on to a second surface
    bool camera_rays = false;            // not the rasteriser but rays find what pixels see: Preview decides
    std::map<std::string, bool> skipped; // name -> left out

    // max_depth  surfaces along a path, 1: direct light alone
    // kept       names of skip_names() that are not to be left out
    static Needs of(const Scene& scene, const BlockingShape& shape, const CameraSpec& camera, int footprint_samples,
                    int max_depth, const std::set<std::string>& kept);
    // Samples that share a ray pass cloth or not, each by itself: the visibility pass cannot know.
    bool layers() const { return gaps && several_points; }
    bool traces_rays() const { return shadows != ShadowNeed::none || bounces || layers() || camera_rays; }
    // The definitions of the shaders: the model's; those of a shader that sees lights and nothing else; all.
    std::vector<std::string> model_defines() const;
    std::vector<std::string> light_defines() const;
    std::vector<std::string> defines() const;
};

} // namespace selvedge
