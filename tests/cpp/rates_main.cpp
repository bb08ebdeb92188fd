// selvedge-rates: what a sample of the direct integrator costs, against the same rays in bare Embree, in one process
// and in turn; and what a scene costs to build, by its number of triangles. tests/bench/reference.py runs it.
//   selvedge-rates samples SCENE --rounds N   nanoseconds on one thread
//   selvedge-rates build --triangles N        seconds and bytes of a sphere
// JSON on stdout. Exit 0 done, 1 input failed, 2 wrong usage.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <tbb/global_control.h>
#include <unistd.h>

#include "bake/error.hpp"
#include "bake/program.hpp"
#include "reference/integrator.hpp"

namespace
{

using namespace selvedge;
namespace f32 = cloth::f32;

struct Options {
    std::string scene;
    Overrides overrides;
    int side = 128, spp = 16, rounds = 7;
    std::uint64_t triangles = 1000;
};

template <class Work> double seconds_of(const Work& work)
{
    const auto start = std::chrono::steady_clock::now();
    work();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

struct Query {
    glm::vec3 origin, direction;
    float far;
};

// The camera rays of a picture, pixel by pixel as the integrator goes, and from what they meet a shadow ray to each
// light that the integrator asks, where it is on the viewer's side.
void find_rays(const Scene& scene, const RayScene& rays, const Options& options, std::vector<Query>& camera_rays,
               std::vector<Query>& shadow_rays)
{
    const f32::ClothCamera camera = make_camera(scene.camera, {options.side, options.side});
    const f32::ClothLights lights = lights_of(scene);
    for (int pixel = 0; pixel < options.side * options.side; ++pixel)
        for (int s = 0; s < options.spp; ++s) {
            const f32::ClothRandom random{f32::cloth_hash(std::uint32_t(pixel)), std::uint32_t(s), 0};
            const glm::vec2 raster =
                glm::vec2(pixel % options.side, pixel / options.side) + f32::cloth_draw(random, f32::cloth_dim_pixel);
            const f32::ClothRay ray = f32::cloth_camera_ray(camera, raster);
            camera_rays.push_back({ray.origin, ray.direction, std::numeric_limits<float>::infinity()});
            const RayHit hit = rays.closest(ray.origin, ray.direction, 0.0f, std::numeric_limits<float>::infinity());
            if (!hit.any || lights.count == 0) continue;
            const f32::ClothSurface surface =
                f32::cloth_surface(triangle_of(scene.objects[hit.object], hit.triangle), ray);
            const int slots = f32::cloth_light_slots(lights, true);
            for (int slot = 0; slot < slots; ++slot) {
                const f32::ClothRandom own = f32::cloth_slot_random(random, slot);
                const f32::ClothLightChoice choice =
                    f32::cloth_ask_light(lights, slot, slots, f32::cloth_draw(own, f32::cloth_dim_light).x);
                const f32::ClothLightSample seen = f32::cloth_light_sample(
                    lights, choice.light, surface.position, f32::cloth_draw(own, f32::cloth_dim_subtexel),
                    f32::cloth_draw_bits(own, f32::cloth_dim_emitter));
                if (seen.pdf <= 0.0f || glm::dot(seen.wi, surface.normal_g) <= 0.0f) continue;
                shadow_rays.push_back(
                    {f32::cloth_leave(surface.position, surface.normal_g), seen.wi, seen.distance * (1.0f - 1e-4f)});
            }
        }
}

double median(std::vector<double> values)
{
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
}

nlohmann::json samples(const Options& options)
{
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
    const Scene scene = load_scene(options.scene, options.overrides);
    const RayScene rays(scene);
    RenderSettings settings;
    settings.integrator = Integrator::direct;
    settings.block_length = std::uint32_t(options.spp);
    settings.resolution = {options.side, options.side};
    settings.region = {0, 0, options.side, options.side};
    const Renderer renderer(scene, rays, settings);

    // Bare: the same triangles in a tree of their own without filters, which is what Embree does best.
    Scene bare_scene;
    for (const SceneObject& object : scene.objects) {
        bare_scene.objects.push_back(object);
        bare_scene.objects.back().fabric = -1;
    }
    const RayScene bare(bare_scene);
    std::vector<Query> camera_rays, shadow_rays;
    find_rays(scene, bare, options, camera_rays, shadow_rays);

    std::vector<double> sample_ns, closest_ns, occluded_ns, ratio;
    RenderState state;
    volatile float kept = 0.0f; // a result that nobody reads is a loop that nobody runs
    const double count = double(options.side) * options.side * options.spp;
    for (int round = -1; round < options.rounds; ++round) { // the first one warms caches and is thrown away
        state = renderer.start();
        const double ours = seconds_of([&] { renderer.add_samples(state, std::uint32_t(options.spp)); }) * 1e9 / count;
        const double closest = seconds_of([&] {
                                   float sum = 0.0f;
                                   for (const Query& ray : camera_rays)
                                       sum += bare.closest(ray.origin, ray.direction, 0.0f, ray.far).distance;
                                   kept = sum;
                               }) *
                               1e9 / double(camera_rays.size());
        const double occluded =
            seconds_of([&] {
                float sum = 0.0f;
                for (const Query& ray : shadow_rays)
                    sum += bare.transmittance(ray.origin, ray.direction, ray.far, scene.model.settings);
                kept = sum;
            }) *
            1e9 / double(std::max<std::size_t>(shadow_rays.size(), 1));
        if (round < 0) continue;
        sample_ns.push_back(ours);
        closest_ns.push_back(closest);
        occluded_ns.push_back(occluded);
        // One camera ray a sample, and as many shadow rays as the integrator had.
        ratio.push_back((closest + occluded * double(state.shadow_rays) / count) / ours);
    }
    return {{"samples", count},
            {"sample_ns", median(sample_ns)},
            {"closest_ns", median(closest_ns)},
            {"occluded_ns", median(occluded_ns)},
            {"shadow_rays_per_sample", double(state.shadow_rays) / count},
            {"rays_per_sample", double(state.rays) / count},
            {"samples_over_raw_embree", median(ratio)}};
}

std::uint64_t resident_bytes()
{
    std::ifstream file("/proc/self/statm");
    std::uint64_t total = 0, resident = 0;
    file >> total >> resident;
    return resident * std::uint64_t(sysconf(_SC_PAGESIZE));
}

// A sphere of about so many triangles, matte: the mesh, and what the tree adds to it.
nlohmann::json build(const Options& options)
{
    Scene scene;
    const int rows = std::max(2, int(std::lround(std::sqrt(double(options.triangles) / 4.0)))), columns = 2 * rows;
    const std::uint64_t before = resident_bytes();
    SceneObject object;
    for (int j = 0; j <= rows; ++j)
        for (int i = 0; i <= columns; ++i) {
            const double theta = std::numbers::pi * j / rows, phi = 2.0 * std::numbers::pi * i / columns;
            const glm::vec3 p(
                glm::dvec3(std::sin(theta) * std::cos(phi), std::cos(theta), std::sin(theta) * std::sin(phi)));
            object.mesh.positions.push_back(p);
            object.mesh.normals.push_back(p);
        }
    for (int j = 0; j < rows; ++j)
        for (int i = 0; i < columns; ++i) {
            const unsigned a = unsigned(j * (columns + 1) + i), b = a + unsigned(columns) + 1u;
            object.mesh.triangles.push_back({a, a + 1u, b});
            object.mesh.triangles.push_back({a + 1u, b + 1u, b});
        }
    const std::size_t count = object.mesh.triangles.size();
    object.mesh.corner_tiles.assign(3 * count, glm::vec2(0.0f));
    object.mesh.tile_base.assign(count, glm::ivec2(0));
    for (std::vector<glm::vec3>* vertices : {&object.mesh.positions, &object.mesh.normals}) vertices->shrink_to_fit();
    object.mesh.triangles.shrink_to_fit();
    scene.objects.push_back(std::move(object));
    const std::uint64_t mesh = resident_bytes();
    std::unique_ptr<RayScene> rays;
    const double seconds = seconds_of([&] { rays = std::make_unique<RayScene>(scene); });
    const std::uint64_t tree = resident_bytes();
    return {{"triangles", rays->needs().triangles},
            {"seconds", seconds},
            {"mesh_bytes", mesh - before},
            {"tree_bytes", tree - mesh},
            {"bytes_per_triangle", double(tree - before) / double(count)}};
}

int run(int argc, char** argv)
{
    Options options;
    CLI::App app("Cost of a sample against bare Embree, cost of a build.", "selvedge-rates");
    app.require_subcommand(1);
    app.add_flag("--json")->description("accepted: the output is always JSON");
    app.fallthrough();
    CLI::App* rates = app.add_subcommand("samples", "nanoseconds of a sample and of the bare rays, one thread");
    rates->add_option("scene", options.scene, "SCENE.json")->required();
    rates->add_option("--side", options.side, "pixels (default 128 x 128)")->check(CLI::Range(1, 4096));
    rates->add_option("--spp", options.spp, "samples a pixel and round (default 16)")->check(CLI::Range(1, 64));
    rates->add_option("--rounds", options.rounds, "median of so many (default 7)")->check(CLI::Range(1, 1000));
    rates->add_option("-D", options.overrides, "path.to.key=value, as the programs")->allow_extra_args(false);
    CLI::App* sphere = app.add_subcommand("build", "seconds and bytes of a sphere's tree");
    sphere->add_option("--triangles", options.triangles, "about (default 1000)")->check(CLI::Range(8, 1 << 26));
    if (!parse_command_line(app, argc, argv)) return 0;
    std::printf("%s\n", (rates->parsed() ? samples(options) : build(options)).dump().c_str());
    return 0;
}

} // namespace

int main(int argc, char** argv)
{
    return selvedge::run_program("selvedge-rates", [&] { return run(argc, argv); });
}
