// Meshes as they come from files and built-in shapes, and their placing in the world. The scene loader includes it.
// mesh.cpp is the only file that includes assimp, which reads OBJ and glTF; PLY is read by ply_file.hpp.
#pragma once

#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "reference/scene.hpp"

namespace selvedge
{

// A mesh in its own space, vertices shared wherever position and normal are the same.
struct SourceMesh {
    std::vector<glm::vec3> positions;
    std::vector<glm::vec3> normals;    // per vertex, unit
    std::vector<glm::uvec3> triangles; // counter-clockwise seen from the front
    std::vector<glm::vec2> corner_uv;  // 3 per triangle; empty: the file has none
};

// Reads OBJ, PLY, GLB or GLTF: all its triangles and polygons, in the poses of its nodes. Points and lines are left
// out, missing normals are made from the faces around a position, each with a warning.
//   needs_uv  a fabric lies on it
//   throws    InputError in one line: missing or broken file, no faces, positions that are not finite, indices out of
//             range, no UVs where they are needed, UVs without any area
SourceMesh load_mesh(const std::string& path, bool needs_uv, std::vector<std::string>& warnings);

// plane: 1 m square in y = 0, faces up, u along +x, v along -z. sphere: radius 1, v from the south pole up. cylinder:
// radius 1, height 1, about y, centre at 0, with caps; u around, v up. drape, curtain: simulated cloth out of
// assets/meshes, in metres, as it lies on assets/scenes/demo.json.
//   divisions  of the plane's sides
//   throws     InputError where the asset is missing; the name is one of the five
SourceMesh make_shape(const std::string& name, int divisions, std::vector<std::string>& warnings);

// Folder of our own assets: $SELVEDGE_ASSETS, else the source tree's, else the installed one.
std::string assets_folder();

// World space, UV in tiles. Triangles without area are left out (one warning with their count); a mirroring transform
// turns the winding around, so that the front stays the front.
//   tiles_from_uv  from UV to repeats of the fabric; 0 for matte
//   throws         InputError: nothing is left, or positions overflow
Mesh place_mesh(const SourceMesh& source, const glm::dmat4& to_world, const glm::dmat2& tiles_from_uv,
                const std::string& name, std::vector<std::string>& warnings);

} // namespace selvedge
