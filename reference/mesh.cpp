// Mesh files through assimp, built-in shapes, placing in the world.
#include "reference/mesh.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>
#include <unordered_map>

#include <assimp/DefaultLogger.hpp>
#include <assimp/Importer.hpp>
#include <assimp/LogStream.hpp>
#include <assimp/importerdesc.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include "bake/error.hpp"
#include "reference/ply_file.hpp"

#ifndef SELVEDGE_ASSETS_SOURCE
#define SELVEDGE_ASSETS_SOURCE "assets"
#endif
#ifndef SELVEDGE_ASSETS_INSTALLED
#define SELVEDGE_ASSETS_INSTALLED "/usr/share/selvedge/assets"
#endif

namespace selvedge
{

namespace
{

constexpr std::uintmax_t file_size_limit = std::uintmax_t(2) << 30;
constexpr std::size_t triangle_limit = std::size_t(1) << 27; // an index into a BVH leaf has 29 bits
constexpr float position_limit = 1e9f;                       // squares of lengths stay finite in float

bool is_finite(glm::vec3 v)
{
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

struct VertexKey {
    std::array<std::uint32_t, 6> words;
    bool operator==(const VertexKey&) const = default;
};

struct VertexKeyHash {
    std::size_t operator()(const VertexKey& key) const
    {
        std::uint64_t h = 0xcbf29ce484222325u;
        for (const std::uint32_t word : key.words) h = (h ^ word) * 0x9e3779b97f4a7c15u, h ^= h >> 29;
        return std::size_t(h);
    }
};

VertexKey vertex_key(glm::vec3 position, glm::vec3 normal)
{
    position += glm::vec3(0.0f); // -0 and 0 are one place
    normal += glm::vec3(0.0f);
    VertexKey key;
    std::memcpy(key.words.data(), &position, 12);
    std::memcpy(key.words.data() + 3, &normal, 12);
    return key;
}

// Gives each corner's position and normal an index, equal ones the same.
class VertexPool
{
  public:
    explicit VertexPool(SourceMesh& mesh) : mesh_(mesh) {}
    std::uint32_t add(glm::vec3 position, glm::vec3 normal)
    {
        const auto [place, fresh] =
            index_.try_emplace(vertex_key(position, normal), std::uint32_t(mesh_.positions.size()));
        if (fresh) {
            mesh_.positions.push_back(position);
            mesh_.normals.push_back(normal);
        }
        return place->second;
    }

  private:
    SourceMesh& mesh_;
    std::unordered_map<VertexKey, std::uint32_t, VertexKeyHash> index_;
};

// Normals where there are none (length 0): mean of the faces around a position, weighted by their angle there.
//   source  Thuermer & Wuethrich 1998, "Computing Vertex Normals from Polygonal Facets"
void make_missing_normals(SourceMesh& mesh)
{
    std::unordered_map<VertexKey, glm::dvec3, VertexKeyHash> sums;
    for (const glm::uvec3& triangle : mesh.triangles) {
        glm::dvec3 p[3];
        for (int k = 0; k < 3; ++k) p[k] = mesh.positions[triangle[k]];
        const glm::dvec3 n = glm::cross(p[1] - p[0], p[2] - p[0]);
        const double length = glm::length(n);
        if (!(length > 0.0)) continue;
        for (int k = 0; k < 3; ++k) {
            if (mesh.normals[triangle[k]] != glm::vec3(0.0f)) continue;
            const glm::dvec3 a = p[(k + 1) % 3] - p[k], b = p[(k + 2) % 3] - p[k];
            const double angle = std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
            sums[vertex_key(mesh.positions[triangle[k]], glm::vec3(0.0f))] += n * (angle / length);
        }
    }
    for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
        if (mesh.normals[v] != glm::vec3(0.0f)) continue;
        const auto found = sums.find(vertex_key(mesh.positions[v], glm::vec3(0.0f)));
        const double length = found == sums.end() ? 0.0 : glm::length(found->second);
        // Faces that cancel out, or a vertex of degenerate faces only: any normal; cloth_surface takes the geometric
        // one.
        mesh.normals[v] = length > 1e-9 ? glm::vec3(found->second / length) : glm::vec3(0.0f, 1.0f, 0.0f);
    }
}

std::string one_line(std::string text)
{
    for (char& c : text)
        if (c == '\n' || c == '\r' || c == '\t') c = ' ';
    while (!text.empty() && text.back() == ' ') text.pop_back();
    return text;
}

// Gathers what assimp complains of while it lives: it goes on after errors, with less than the file holds. The logger
// is global, so files are loaded one at a time.
class Complaints
{
  public:
    Complaints()
    {
        Assimp::DefaultLogger::create(nullptr, Assimp::Logger::NORMAL, 0);
        Assimp::DefaultLogger::get()->attachStream(&stream_, Assimp::Logger::Err);
    }
    ~Complaints()
    {
        Assimp::DefaultLogger::get()->detachStream(&stream_, Assimp::Logger::Err);
        Assimp::DefaultLogger::kill();
    }
    Complaints(const Complaints&) = delete;
    Complaints& operator=(const Complaints&) = delete;
    const std::string& first() const { return stream_.first; }
    std::size_t count() const { return stream_.count; }

  private:
    struct Stream : Assimp::LogStream {
        void write(const char* message) override
        {
            std::string text = one_line(message);
            // "Error, T0: OBJ: ..."
            if (const auto colon = text.find(": "); text.rfind("Error, ", 0) == 0 && colon != std::string::npos)
                text = text.substr(colon + 2);
            if (text.find("material") != std::string::npos) return; // its colours are not ours
            if (count++ == 0) first = text;
        }
        std::string first;
        std::size_t count = 0;
    };
    Stream stream_;
};

// What a file gives.
struct Gathered {
    SourceMesh mesh;
    VertexPool pool{mesh};
    std::size_t corners_without_uv = 0, corners_without_normal = 0;
    std::size_t left_out = 0; // points and lines
    std::size_t complaints = 0;
    std::string complaint; // the first

    std::uint32_t add_corner(glm::vec3 position, glm::vec3 normal, const glm::vec2* uv)
    {
        const float length = glm::length(normal);
        normal = std::isfinite(length) && length > 1e-12f ? normal / length : glm::vec3(0.0f);
        corners_without_normal += normal == glm::vec3(0.0f) ? 1 : 0;
        const bool good = uv && std::isfinite(uv->x) && std::isfinite(uv->y);
        corners_without_uv += good ? 0 : 1;
        mesh.corner_uv.push_back(good ? *uv : glm::vec2(0.0f));
        return pool.add(position, normal);
    }
};

void check_position(const std::string& path, std::size_t vertex, glm::vec3 p)
{
    if (!is_finite(p) || std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) > position_limit)
        throw InputError(path, 0, "vertex %zu: found position (%g, %g, %g), expected finite numbers up to %g", vertex,
                         double(p.x), double(p.y), double(p.z), double(position_limit));
}

// Indices out of range would crash assimp's own steps, so they are looked at before any of those runs.
void check_mesh(const std::string& path, const aiMesh& part)
{
    if (part.mNumVertices > 0 && !part.mVertices) throw InputError(path, 0, "found vertices without positions");
    for (unsigned f = 0; f < part.mNumFaces; ++f) {
        const aiFace& face = part.mFaces[f];
        for (unsigned k = 0; k < face.mNumIndices; ++k)
            if (face.mIndices[k] >= part.mNumVertices)
                throw InputError(path, 0, "face %u: found vertex index %d, expected 0 to %d", f, int(face.mIndices[k]),
                                 int(part.mNumVertices) - 1);
    }
    for (unsigned v = 0; v < part.mNumVertices; ++v)
        check_position(path, v, {part.mVertices[v].x, part.mVertices[v].y, part.mVertices[v].z});
}

void gather_part(Gathered& out, const aiMesh& part, const aiMatrix4x4& pose)
{
    const aiMatrix3x3 turn(pose);
    aiMatrix3x3 normal_turn = turn;
    normal_turn.Inverse().Transpose();
    const bool mirrored = turn.Determinant() < 0.0f;
    for (unsigned f = 0; f < part.mNumFaces; ++f) {
        const aiFace& face = part.mFaces[f];
        if (face.mNumIndices != 3) continue;
        glm::uvec3 triangle(0u);
        for (unsigned k = 0; k < 3; ++k) {
            const unsigned corner = mirrored ? 2 - k : k;
            const unsigned v = face.mIndices[corner];
            const aiVector3D p = pose * part.mVertices[v];
            glm::vec3 normal(0.0f);
            if (part.HasNormals()) {
                const aiVector3D n = normal_turn * part.mNormals[v];
                normal = {n.x, n.y, n.z};
            }
            glm::vec2 uv(0.0f);
            if (part.HasTextureCoords(0)) uv = {part.mTextureCoords[0][v].x, part.mTextureCoords[0][v].y};
            triangle[int(k)] = out.add_corner({p.x, p.y, p.z}, normal, part.HasTextureCoords(0) ? &uv : nullptr);
        }
        out.mesh.triangles.push_back(triangle);
    }
}

void gather_node(Gathered& out, const aiScene& scene, const aiNode& node, const aiMatrix4x4& above, int depth)
{
    const aiMatrix4x4 pose = above * node.mTransformation;
    for (unsigned m = 0; m < node.mNumMeshes; ++m)
        if (node.mMeshes[m] < scene.mNumMeshes) gather_part(out, *scene.mMeshes[node.mMeshes[m]], pose);
    for (unsigned c = 0; c < node.mNumChildren && depth < 256; ++c)
        gather_node(out, scene, *node.mChildren[c], pose, depth + 1);
}

// Cuts a polygon into triangles by its ears, in the plane that it lies in most. A polygon that crosses itself gives a
// fan.
//   corners  indices into `positions`;  calls add(a, b, c) with places in `corners`
template <class Add>
void cut_polygon(const std::vector<glm::vec3>& positions, const std::uint32_t* corners, std::uint32_t count, Add&& add)
{
    if (count == 3) return add(0u, 1u, 2u);
    glm::dvec3 normal(0.0); // Newell's sum
    const glm::dvec3 origin = positions[corners[0]];
    for (std::uint32_t k = 0; k < count; ++k)
        normal += glm::cross(glm::dvec3(positions[corners[k]]) - origin,
                             glm::dvec3(positions[corners[(k + 1) % count]]) - origin);
    const auto turn = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
        const glm::dvec3 p = positions[corners[a]];
        return glm::dot(glm::cross(glm::dvec3(positions[corners[b]]) - p, glm::dvec3(positions[corners[c]]) - p),
                        normal);
    };
    std::vector<std::uint32_t> left(count);
    for (std::uint32_t k = 0; k < count; ++k) left[k] = k;
    while (left.size() > 3) {
        std::size_t ear = left.size();
        for (std::size_t k = 0; k < left.size() && ear == left.size(); ++k) {
            const std::uint32_t a = left[(k + left.size() - 1) % left.size()], b = left[k],
                                c = left[(k + 1) % left.size()];
            if (turn(a, b, c) <= 0.0) continue;
            const bool empty = std::none_of(left.begin(), left.end(), [&](std::uint32_t p) {
                return p != a && p != b && p != c && turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 &&
                       turn(c, a, p) >= 0.0;
            });
            if (empty) ear = k;
        }
        if (ear == left.size()) ear = 1;
        add(left[(ear + left.size() - 1) % left.size()], left[ear], left[(ear + 1) % left.size()]);
        left.erase(left.begin() + std::ptrdiff_t(ear));
    }
    add(left[0], left[1], left[2]);
}

constexpr std::uint32_t polygon_limit = 4096; // corners: cutting takes their number cubed at worst

void gather_ply(Gathered& out, const std::string& path)
{
    const PlyFile file = read_ply(path);
    for (std::size_t v = 0; v < file.positions.size(); ++v) check_position(path, v, file.positions[v]);
    std::size_t first = 0;
    for (std::size_t f = 0; f < file.face_sizes.size(); first += file.face_sizes[f++]) {
        const std::uint32_t count = file.face_sizes[f];
        if (count < 3) {
            ++out.left_out;
            continue;
        }
        if (count > polygon_limit)
            throw InputError(path, 0, "face %zu: found %u corners, expected at most %u", f, count, polygon_limit);
        const std::uint32_t* corners = file.corners.data() + first;
        cut_polygon(file.positions, corners, count, [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
            glm::uvec3 triangle;
            const std::uint32_t places[3] = {a, b, c};
            for (int k = 0; k < 3; ++k) {
                const std::uint32_t v = corners[places[k]];
                const glm::vec2* uv = !file.corner_uv.empty() ? &file.corner_uv[first + places[k]]
                                      : !file.uv.empty()      ? &file.uv[v]
                                                              : nullptr;
                triangle[k] =
                    out.add_corner(file.positions[v], file.normals.empty() ? glm::vec3(0.0f) : file.normals[v], uv);
            }
            out.mesh.triangles.push_back(triangle);
        });
    }
}

// A chunk that claims more than the file holds makes assimp allocate that much before it looks.
void check_glb(const std::string& path)
{
    std::ifstream file(path, std::ios::binary);
    std::array<unsigned char, 20> head{};
    file.read(reinterpret_cast<char*>(head.data()), std::streamsize(head.size()));
    const auto word = [&](std::size_t at) {
        return std::uint64_t(head[at]) | std::uint64_t(head[at + 1]) << 8 | std::uint64_t(head[at + 2]) << 16 |
               std::uint64_t(head[at + 3]) << 24;
    };
    std::error_code code;
    const std::uint64_t size = std::filesystem::file_size(path, code);
    if (!file || word(0) != 0x46546c67) throw InputError(path, 0, "found another kind of file, expected a binary glTF");
    if (word(8) > size || word(12) > size - 20)
        throw InputError(path, 0, "truncated: found %llu bytes, expected %llu", static_cast<unsigned long long>(size),
                         static_cast<unsigned long long>(std::max(word(8), word(12) + 20)));
}

// OBJ, GLB, GLTF.
void gather_file(Gathered& out, const std::string& path, const std::string& extension)
{
    if (extension == ".glb") check_glb(path);
    const Complaints complaints;
    Assimp::Importer importer;
    // Only the formats that are asked for: assimp would guess others from the contents.
    for (std::size_t k = importer.GetImporterCount(); k-- > 0;) {
        const std::string known = std::string(" ") + importer.GetImporterInfo(k)->mFileExtensions + " ";
        if (known.find(" " + extension.substr(1) + " ") == std::string::npos)
            importer.UnregisterLoader(importer.GetImporter(k));
    }
    const aiScene* scene = importer.ReadFile(path, 0);
    if (!scene) throw InputError(path, 0, "found a broken mesh file (%s)", one_line(importer.GetErrorString()).c_str());
    for (unsigned m = 0; m < scene->mNumMeshes; ++m) {
        check_mesh(path, *scene->mMeshes[m]);
        for (unsigned f = 0; f < scene->mMeshes[m]->mNumFaces; ++f)
            out.left_out += scene->mMeshes[m]->mFaces[f].mNumIndices < 3 ? 1 : 0;
    }
    scene = importer.ApplyPostProcessing(aiProcess_Triangulate);
    if (!scene) throw InputError(path, 0, "found polygons that cannot be cut into triangles");
    if (scene->mRootNode) gather_node(out, *scene, *scene->mRootNode, aiMatrix4x4(), 0);
    out.complaints = complaints.count();
    out.complaint = complaints.first();
}

// Area of a triangle in UV, signed.
double uv_area(const SourceMesh& mesh, std::size_t triangle)
{
    const glm::dvec2 a = mesh.corner_uv[3 * triangle], b = mesh.corner_uv[3 * triangle + 1],
                     c = mesh.corner_uv[3 * triangle + 2];
    return 0.5 * ((b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y));
}

SourceMesh make_plane(int divisions)
{
    SourceMesh mesh;
    const int n = divisions;
    for (int j = 0; j <= n; ++j)
        for (int i = 0; i <= n; ++i) {
            mesh.positions.push_back({float(i) / float(n) - 0.5f, 0.0f, 0.5f - float(j) / float(n)});
            mesh.normals.push_back({0.0f, 1.0f, 0.0f});
        }
    const auto add = [&](int i0, int j0, int i1, int j1, int i2, int j2) {
        const int i[3] = {i0, i1, i2}, j[3] = {j0, j1, j2};
        mesh.triangles.push_back(glm::uvec3(j0 * (n + 1) + i0, j1 * (n + 1) + i1, j2 * (n + 1) + i2));
        for (int k = 0; k < 3; ++k) mesh.corner_uv.push_back({float(i[k]) / float(n), float(j[k]) / float(n)});
    };
    for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) {
            add(i, j, i + 1, j, i + 1, j + 1);
            add(i, j, i + 1, j + 1, i, j + 1);
        }
    return mesh;
}

// Surface of revolution about y. Point (u, v) of the grid: at(u, v) with position and normal.
template <class Point> void add_revolved(SourceMesh& mesh, int around, int up, Point&& at)
{
    const std::uint32_t first = std::uint32_t(mesh.positions.size());
    const std::uint32_t columns = std::uint32_t(around) + 1;
    for (int j = 0; j <= up; ++j)
        for (int i = 0; i <= around; ++i) {
            // The seam's last column is the first one: the same bits, so that it is closed.
            const double phi = 2.0 * std::numbers::pi * double(i % around) / around;
            const auto [position, normal] = at(phi, double(j) / up);
            mesh.positions.push_back(position);
            mesh.normals.push_back(normal);
        }
    const auto add = [&](int i0, int j0, int i1, int j1, int i2, int j2) {
        const int i[3] = {i0, i1, i2}, j[3] = {j0, j1, j2};
        glm::uvec3 triangle;
        for (int k = 0; k < 3; ++k) triangle[k] = first + std::uint32_t(j[k]) * columns + std::uint32_t(i[k]);
        mesh.triangles.push_back(triangle);
        for (int k = 0; k < 3; ++k) mesh.corner_uv.push_back({float(i[k]) / float(around), float(j[k]) / float(up)});
    };
    for (int j = 0; j < up; ++j)
        for (int i = 0; i < around; ++i) {
            add(i, j, i + 1, j, i + 1, j + 1);
            add(i, j, i + 1, j + 1, i, j + 1);
        }
}

// Going around y by phi, seen from above counter-clockwise, so that u to the right and v up face outward.
glm::dvec2 on_circle(double phi)
{
    return {std::sin(phi), std::cos(phi)};
} // x, z

SourceMesh make_sphere()
{
    SourceMesh mesh;
    add_revolved(mesh, 192, 96, [](double phi, double v) {
        const double theta = std::numbers::pi * (1.0 - v);
        const double radius = v <= 0.0 || v >= 1.0 ? 0.0 : std::sin(theta);
        const glm::vec3 p(glm::dvec3(radius * on_circle(phi).x, std::cos(theta), radius * on_circle(phi).y));
        return std::pair(p, p);
    });
    // The rows at the poles have triangles without area.
    SourceMesh out = mesh;
    out.triangles.clear();
    out.corner_uv.clear();
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
        const glm::uvec3 i = mesh.triangles[t];
        if (mesh.positions[i.x] == mesh.positions[i.y] || mesh.positions[i.y] == mesh.positions[i.z] ||
            mesh.positions[i.z] == mesh.positions[i.x])
            continue;
        out.triangles.push_back(i);
        for (std::size_t k = 0; k < 3; ++k) out.corner_uv.push_back(mesh.corner_uv[3 * t + k]);
    }
    return out;
}

SourceMesh make_cylinder()
{
    constexpr int around = 256;
    SourceMesh mesh;
    add_revolved(mesh, around, 32, [](double phi, double v) {
        const glm::vec3 normal(glm::dvec3(on_circle(phi).x, 0.0, on_circle(phi).y));
        return std::pair(normal + glm::vec3(0.0f, float(v - 0.5), 0.0f), normal);
    });
    for (const float side : {-1.0f, 1.0f}) {
        const std::uint32_t centre = std::uint32_t(mesh.positions.size());
        mesh.positions.push_back({0.0f, 0.5f * side, 0.0f});
        mesh.normals.push_back({0.0f, side, 0.0f});
        for (int i = 0; i < around; ++i) {
            const glm::dvec2 c = on_circle(2.0 * std::numbers::pi * i / around);
            mesh.positions.push_back({float(c.x), 0.5f * side, float(c.y)});
            mesh.normals.push_back({0.0f, side, 0.0f});
        }
        for (std::uint32_t i = 0; i < around; ++i) {
            const std::uint32_t a = centre + 1 + i, b = centre + 1 + (i + 1) % around;
            mesh.triangles.push_back(side > 0.0f ? glm::uvec3(centre, a, b) : glm::uvec3(centre, b, a));
            // One unit of u is a whole turn, 2 pi for radius 1: the caps have the wall's scale in x.
            for (int k = 0; k < 3; ++k) {
                const glm::vec3 p = mesh.positions[mesh.triangles.back()[k]];
                mesh.corner_uv.push_back(glm::vec2(p.x, -side * p.z) / float(2.0 * std::numbers::pi) + glm::vec2(0.5f));
            }
        }
    }
    return mesh;
}

} // namespace

SourceMesh load_mesh(const std::string& path, bool needs_uv, std::vector<std::string>& warnings)
{
    std::error_code code;
    const auto status = std::filesystem::status(path, code);
    if (!std::filesystem::exists(status)) throw InputError(path, 0, "found no such file, expected a mesh");
    if (std::filesystem::is_directory(status)) throw InputError(path, 0, "found a folder, expected a mesh");
    if (std::filesystem::file_size(path, code) > file_size_limit || code)
        throw InputError(path, 0, "found a file larger than 2 GiB, expected a smaller mesh");
    std::string extension = std::filesystem::path(path).extension().string();
    for (char& c : extension) c = char(std::tolower(static_cast<unsigned char>(c)));
    if (extension != ".obj" && extension != ".ply" && extension != ".glb" && extension != ".gltf")
        throw InputError(path, 0, "found \"%s\", expected a mesh that ends in .obj, .ply, .glb or .gltf",
                         extension.c_str());

    Gathered gathered;
    if (extension == ".ply")
        gather_ply(gathered, path);
    else
        gather_file(gathered, path, extension);
    SourceMesh& mesh = gathered.mesh;
    if (mesh.triangles.empty()) {
        const std::string why = gathered.complaints > 0 ? " (" + gathered.complaint + ")" : "";
        if (gathered.left_out > 0)
            throw InputError(path, 0, "found only %zu points or lines%s, expected triangles or polygons",
                             gathered.left_out, why.c_str());
        throw InputError(path, 0, "found no faces%s, expected triangles or polygons", why.c_str());
    }
    if (mesh.triangles.size() > triangle_limit)
        throw InputError(path, 0, "found %zu triangles, expected at most %zu", mesh.triangles.size(), triangle_limit);
    if (gathered.complaints > 0)
        warnings.push_back(format_text(
            "%s: %s%s", path.c_str(), gathered.complaint.c_str(),
            gathered.complaints > 1 ? format_text(" (and %zu more complaints)", gathered.complaints - 1).c_str() : ""));
    if (gathered.left_out > 0)
        warnings.push_back(format_text("%s: %zu points or lines left out", path.c_str(), gathered.left_out));
    if (gathered.corners_without_normal > 0) {
        if (gathered.corners_without_normal < 3 * mesh.triangles.size())
            warnings.push_back(format_text("%s: %zu of %zu corners without a normal; made from the faces", path.c_str(),
                                           gathered.corners_without_normal, 3 * mesh.triangles.size()));
        make_missing_normals(mesh);
    }

    const bool has_uv = gathered.corners_without_uv < 3 * mesh.triangles.size();
    if (!has_uv) mesh.corner_uv.clear();
    if (needs_uv) {
        if (!has_uv) throw InputError(path, 0, "found no UVs, expected texture coordinates since a fabric lies on it");
        std::size_t flat = 0;
        for (std::size_t t = 0; t < mesh.triangles.size(); ++t) flat += std::abs(uv_area(mesh, t)) < 1e-14 ? 1 : 0;
        if (flat == mesh.triangles.size())
            throw InputError(path, 0,
                             "found UVs without any area, expected an unwrapped mesh since a fabric lies on it");
        if (flat > 0)
            warnings.push_back(
                format_text("%s: %zu of %zu triangles have UVs without area: the cloth has no direction there",
                            path.c_str(), flat, mesh.triangles.size()));
        if (gathered.corners_without_uv > 0)
            warnings.push_back(format_text("%s: %zu of %zu corners without UV, taken as (0, 0)", path.c_str(),
                                           gathered.corners_without_uv, 3 * mesh.triangles.size()));
    }
    return std::move(mesh);
}

std::string assets_folder()
{
    if (const char* named = std::getenv("SELVEDGE_ASSETS"); named && *named) return named;
    std::error_code code;
    if (std::filesystem::is_directory(SELVEDGE_ASSETS_SOURCE, code)) return SELVEDGE_ASSETS_SOURCE;
    return SELVEDGE_ASSETS_INSTALLED;
}

SourceMesh make_shape(const std::string& name, int divisions, std::vector<std::string>& warnings)
{
    if (name == "plane") return make_plane(divisions);
    if (name == "sphere") return make_sphere();
    if (name == "cylinder") return make_cylinder();
    return load_mesh(assets_folder() + "/meshes/" + name + ".ply", true, warnings);
}

Mesh place_mesh(const SourceMesh& source, const glm::dmat4& to_world, const glm::dmat2& tiles_from_uv,
                const std::string& name, std::vector<std::string>& warnings)
{
    const glm::dmat3 turn(to_world);
    const double determinant = glm::determinant(turn);
    // The cofactor matrix is the inverse transpose times the determinant: normals need no division by a tiny number.
    const glm::dmat3 cofactor(glm::cross(turn[1], turn[2]), glm::cross(turn[2], turn[0]), glm::cross(turn[0], turn[1]));
    const double flip = determinant < 0.0 ? -1.0 : 1.0;

    Mesh mesh;
    mesh.positions.reserve(source.positions.size());
    mesh.normals.reserve(source.positions.size());
    for (std::size_t v = 0; v < source.positions.size(); ++v) {
        const glm::vec3 p(to_world * glm::dvec4(source.positions[v], 1.0));
        if (!is_finite(p) || std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) > position_limit)
            throw InputError(name, 0, "found a vertex at (%g, %g, %g) after the transform, expected at most %g",
                             double(p.x), double(p.y), double(p.z), double(position_limit));
        mesh.positions.push_back(p);
        const glm::dvec3 n = cofactor * glm::dvec3(source.normals[v]) * flip;
        const double length = glm::length(n);
        mesh.normals.push_back(length > 0.0 ? glm::vec3(n / length) : glm::vec3(0.0f, 1.0f, 0.0f));
    }

    std::size_t flat = 0;
    mesh.triangles.reserve(source.triangles.size());
    for (std::size_t t = 0; t < source.triangles.size(); ++t) {
        const glm::uvec3 i = source.triangles[t];
        const glm::dvec3 e1 = glm::dvec3(mesh.positions[i.y]) - glm::dvec3(mesh.positions[i.x]);
        const glm::dvec3 e2 = glm::dvec3(mesh.positions[i.z]) - glm::dvec3(mesh.positions[i.x]);
        const double longest2 = std::max({glm::dot(e1, e1), glm::dot(e2, e2), glm::dot(e2 - e1, e2 - e1)});
        // A height below 1e-6 of the longest edge: float coordinates say nothing about its plane any more.
        if (!(glm::length(glm::cross(e1, e2)) > 1e-6 * longest2)) {
            ++flat;
            continue;
        }
        const bool mirrored = determinant < 0.0;
        mesh.triangles.push_back(mirrored ? glm::uvec3(i.x, i.z, i.y) : i);
        glm::dvec2 tile[3] = {};
        if (!source.corner_uv.empty())
            for (std::size_t k = 0; k < 3; ++k) tile[k] = tiles_from_uv * glm::dvec2(source.corner_uv[3 * t + k]);
        if (mirrored) std::swap(tile[1], tile[2]);
        const glm::dvec2 base = glm::floor(glm::min(tile[0], glm::min(tile[1], tile[2])));
        constexpr double base_limit = 1e9;
        if (!(std::abs(base.x) < base_limit && std::abs(base.y) < base_limit))
            throw InputError(name, 0, "found UVs %g tiles away from 0, expected at most %g (see uv_scale)",
                             std::max(std::abs(base.x), std::abs(base.y)), base_limit);
        mesh.tile_base.push_back(glm::ivec2(base));
        for (const glm::dvec2& corner : tile) mesh.corner_tiles.push_back(glm::vec2(corner - base));
    }
    if (mesh.triangles.empty()) throw InputError(name, 0, "found only triangles without area, expected a surface");
    if (flat > 0)
        warnings.push_back(
            format_text("%s: %zu of %zu triangles without area left out", name.c_str(), flat, source.triangles.size()));
    return mesh;
}

} // namespace selvedge
