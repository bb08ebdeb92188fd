// PLY meshes (Stanford polygon files; not the plies of a yarn): ASCII and binary of either byte order. mesh.cpp
// includes it. Our own reader, since assimp 5.2 hangs on binary files that are cut short.
#pragma once

#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace selvedge
{

// Polygons as the file has them: corners of all faces one after another.
struct PlyFile {
    std::vector<glm::vec3> positions;
    std::vector<glm::vec3> normals;        // per vertex; empty: the file has none
    std::vector<glm::vec2> uv;             // per vertex; empty: none
    std::vector<std::uint32_t> corners;    // vertex indices, below positions.size()
    std::vector<glm::vec2> corner_uv;      // per corner, from a face's "texcoord" list; empty: none
    std::vector<std::uint32_t> face_sizes; // corners of each face; below 3 for points and lines
};

// throws InputError: no PLY, cut short, unknown types, indices out of range, vertices without x, y, z
PlyFile read_ply(const std::string& path);

} // namespace selvedge
