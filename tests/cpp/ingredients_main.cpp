// selvedge-ingredients: what the model's ingredients cost in accuracy, on a baked fabric: visibility against exact
// rays, effective reflectance against path tracing of the relief. tests/bench/{ingredients,bake}.py and
// tests/test_furnace.py run it.
//   selvedge-ingredients visibility FABRIC  --kind KIND...        RMS of V, bytes, ns
//   selvedge-ingredients sweep FABRIC                             seconds of the horizon sweep and of brute force
//   selvedge-ingredients reflectance FABRIC --model NAME:KEY=VALUE,...  one table, by angle and footprint
// JSON on stdout. Exit 0 done, 1 input failed, 2 wrong usage.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <tbb/parallel_for.h>

#include "bake/bake.hpp"
#include "bake/energy.hpp"
#include "bake/error.hpp"
#include "bake/program.hpp"
#include "bake/visibility.hpp"
#include "reference/model.hpp"
#include "relief_truth.hpp"

namespace
{

using namespace selvedge;
namespace f32 = cloth::f32;

constexpr double pi_d = 3.14159265358979323846;

struct Options {
    std::string fabric;
    Overrides overrides;
    int resolution = 0;
    std::vector<std::string> kinds, models;
    std::vector<double> angles{0, 30, 60, 75, 85};
    std::vector<int> footprints{1, 4, 16, 64, 256};
    int places = 1024, samples = 64; // samples for each half of a place
    int side = 0;
};

PackedFabric baked(const Options& options, VisibilityKind kind)
{
    BakeOptions bake_options;
    bake_options.resolution = options.resolution;
    bake_options.visibility = kind;
    bake_options.stacked = false; // the relief's truth reflects, and no more
    return bake_fabric(load_fabric(options.fabric, options.overrides), bake_options);
}

// ---- visibility
// ------------------------------------------------------------------------------------------------------

struct Question {
    glm::ivec2 spot; // in quarters of a texel
    glm::vec3 d;
};

// Spots and directions, uniform in solid angle over the hemisphere.
std::vector<Question> questions(glm::ivec2 size, int count)
{
    std::vector<Question> out;
    TruthRandom random(7);
    for (int k = 0; k < count; ++k) {
        const double z = random.uniform(), phi = 2 * pi_d * random.uniform(), r = std::sqrt(1 - z * z);
        const glm::ivec2 spot(int(random.uniform() * 4 * size.x), int(random.uniform() * 4 * size.y));
        out.push_back({spot, glm::vec3(r * std::cos(phi), r * std::sin(phi), z)});
    }
    return out;
}

double seconds_since(std::chrono::steady_clock::time_point start)
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

nlohmann::json measure_visibility_kinds(const Options& options)
{
    const PackedFabric plain = baked(options, VisibilityKind::horizon8);
    const int blocks = 64, per_block = options.places;
    const std::vector<Question> asked = questions(plain.size, blocks * per_block);
    // Exact: whether a ray from the texel's centre, just above the field, gets away.
    std::vector<float> exact[2];
    for (int side = 0; side < 2; ++side) {
        const ReliefTruth truth(plain, side);
        exact[side].resize(asked.size());
        tbb::parallel_for(std::size_t(0), asked.size(), [&](std::size_t k) {
            const glm::dvec2 at = glm::dvec2(asked[k].spot >> 2) + 0.5;
            exact[side][k] = truth.occluded(at, truth.height_at(at) + truth.lift_m, asked[k].d) ? 0.0f : 1.0f;
        });
    }
    nlohmann::json rows = nlohmann::json::array();
    for (const std::string& name : options.kinds) {
        const bool none = name == "none";
        const PackedFabric fabric = baked(options, none ? VisibilityKind::horizon8 : parse_visibility(name));
        f32::ClothSettings settings = full_model;
        settings.visibility = none ? f32::cloth_visibility_none : visibility_lookup(fabric.visibility);
        const f32::ClothMaps maps = maps_of(fabric);
        const auto look_up = [&](int side, glm::ivec2 spot, glm::vec3 d) {
            return f32::cloth_visibility_at(maps, side, spot, d, settings);
        };
        // Many samples of a texel come to the mean over its spots; kinds without spots give the same for each.
        const auto mean = [&](int side, const Question& q) {
            float sum = 0;
            for (int k = 0; k < 16; ++k) sum += look_up(side, (q.spot & ~3) + glm::ivec2(k & 3, k >> 2), q.d) / 16;
            return sum;
        };
        std::vector<double> block_squares;
        double squares = 0, bias = 0;
        for (int b = 0; b < blocks; ++b) {
            double sum = 0;
            for (int side = 0; side < 2; ++side)
                for (int k = b * per_block; k < (b + 1) * per_block; ++k) {
                    const double e = double(mean(side, asked[std::size_t(k)]) - exact[side][std::size_t(k)]);
                    sum += e * e / (2.0 * per_block);
                    bias += e / (2.0 * per_block * blocks);
                }
            block_squares.push_back(sum);
            squares += sum / blocks;
        }
        double variance = 0;
        for (const double sum : block_squares)
            variance += (sum - squares) * (sum - squares) / (blocks * (blocks - 1.0));
        const double rms = std::sqrt(squares);
        // One thread; the fastest of nine passes, so that other work on the machine counts least.
        double best = 1e9, spent_sum = 0;
        for (int pass = 0; pass < 9; ++pass) {
            const auto start = std::chrono::steady_clock::now();
            for (const Question& q : asked) spent_sum += double(look_up(0, q.spot, q.d));
            best = std::min(best, seconds_since(start) / double(asked.size()));
        }
        rows.push_back({{"kind", name},
                        {"rms", rms},
                        {"rms_95", 1.96 * std::sqrt(variance) / (2 * rms)},
                        {"bias", bias},
                        {"bytes_per_texel", none ? 0 : fabric.visibility_bytes_per_texel()},
                        {"nanoseconds", best * 1e9},
                        {"directions", 2 * asked.size()},
                        {"checksum", spent_sum}});
    }
    return {{"fabric", plain.name}, {"texels", {plain.size.x, plain.size.y}}, {"kinds", rows}};
}

// Seconds of the sweep for both sides' knots, and of marching every block by itself, in the same run.
nlohmann::json measure_sweep(const Options& options)
{
    const PackedFabric fabric = baked(options, VisibilityKind::horizon8);
    std::vector<double> swept;
    double marched = 0, checksum = 0;
    const glm::ivec2 blocks = fabric.size / 2;
    // Of the marches only some rows of blocks, evenly spread, where there are many.
    const int stride = std::max(1, blocks.y / 32);
    for (int side = 0; side < 2; ++side) {
        const std::vector<float> heights = heights_m(fabric, side);
        const HeightField field{fabric.size, fabric.tile_m, &heights};
        const glm::vec2 range_m = height_range(field);
        for (int pass = 0; pass < 5; ++pass) {
            const auto start = std::chrono::steady_clock::now();
            checksum += double(horizon_knots(field).back().x);
            if (side == 0) swept.push_back(0);
            swept[std::size_t(pass)] += seconds_since(start);
        }
        std::vector<double> sums(std::size_t(blocks.y), 0.0);
        const auto start = std::chrono::steady_clock::now();
        tbb::parallel_for(0, blocks.y / stride, [&](int row) {
            const int Y = row * stride;
            for (int X = 0; X < blocks.x; ++X)
                for (int j = 0; j < horizon_azimuths; ++j)
                    sums[std::size_t(Y)] += double(march_horizon(field, range_m, {2 * X + 1, 2 * Y + 1},
                                                                 float(2 * pi_d * (j + 0.5) / horizon_azimuths)));
        });
        marched += seconds_since(start) * blocks.y / (blocks.y / stride);
        for (const double sum : sums) checksum += sum;
    }
    std::sort(swept.begin(), swept.end());
    return {{"fabric", fabric.name},
            {"texels", {fabric.size.x, fabric.size.y}},
            {"sweep_seconds", swept[swept.size() / 2]},
            {"sweep_passes", swept.size()},
            {"march_seconds", marched},
            {"march_rows", blocks.y / stride},
            {"march_rows_of", blocks.y},
            {"checksum", checksum}};
}

// ---- reflectance
// -----------------------------------------------------------------------------------------------------

// "NAME:KEY=VALUE,KEY=VALUE" as the renderers' -D model.KEY=VALUE would have it.
ModelSpec model_of(const std::string& text, std::string& name)
{
    const std::size_t colon = text.find(':');
    name = text.substr(0, colon);
    nlohmann::json object = nlohmann::json::object();
    std::string rest = colon == std::string::npos ? "" : text.substr(colon + 1);
    while (!rest.empty()) {
        const std::string pair = rest.substr(0, rest.find(','));
        rest = pair.size() < rest.size() ? rest.substr(pair.size() + 1) : "";
        const std::size_t equals = pair.find('=');
        if (equals == std::string::npos) throw UsageError("%s: expected KEY=VALUE", pair.c_str());
        const std::string value = pair.substr(equals + 1);
        if (value == "true" || value == "false")
            object[pair.substr(0, equals)] = value == "true";
        else
            object[pair.substr(0, equals)] = value;
    }
    return parse_model(JsonValue::parse(object.dump(), "--model " + name));
}

// What one place of the cloth shows, from two independent halves of the samples.
struct Place {
    double sky[2] = {}, sun[2] = {}, passes = 0;
};

struct Cell {
    f32::ClothFootprint footprint;
    glm::vec3 o;
};

// Squares of texels anywhere on a large cloth, seen at one angle from any side.
std::vector<Cell> cells(glm::ivec2 size, double angle_deg, int texels, int count)
{
    std::vector<Cell> out;
    TruthRandom random(std::uint64_t(texels) * 1009 + std::uint64_t(angle_deg));
    const double c = std::cos(angle_deg * pi_d / 180), s = std::sqrt(1 - c * c);
    for (int k = 0; k < count; ++k) {
        // An additive recurrence spreads the places; the azimuth is free.
        const glm::vec2 tile(std::fmod(0.5 + k * 0.7548776662466927, 1.0),
                             std::fmod(0.5 + k * 0.5698402909980532, 1.0));
        const double phi = 2 * pi_d * random.uniform();
        const glm::ivec2 base(int(1000 * random.uniform()), int(1000 * random.uniform()));
        const glm::vec2 step = glm::vec2(float(texels)) / glm::vec2(size);
        out.push_back({{tile, {step.x, 0}, {0, step.y}, base}, glm::vec3(s * std::cos(phi), s * std::sin(phi), c)});
    }
    return out;
}

// Mean and RMS over places of a difference between two estimates, with 95 % confidence, in units of the truth's mean.
struct Difference {
    double mean = 0, mean_95 = 0, rms = 0, rms_95 = 0, truth = 0;
};

Difference compare(const std::vector<Place>& model, const std::vector<Place>& truth, const double (Place::*member)[2])
{
    const double count = double(model.size());
    double m = 0, t = 0;
    for (std::size_t k = 0; k < model.size(); ++k) {
        m += ((model[k].*member)[0] + (model[k].*member)[1]) / 2 / count;
        t += ((truth[k].*member)[0] + (truth[k].*member)[1]) / 2 / count;
    }
    Difference out;
    out.truth = t;
    if (t <= 0) return out;
    out.mean = m / t - 1;
    double spread = 0, square = 0, fourth = 0;
    for (std::size_t k = 0; k < model.size(); ++k) {
        const double a = (model[k].*member)[0], b = (model[k].*member)[1], x = (truth[k].*member)[0],
                     y = (truth[k].*member)[1];
        const double left = (a + b) / 2 - m / t * (x + y) / 2; // 0 in the mean: error of a ratio of means
        spread += left * left;
        // The halves' errors are independent: their product has no noise in its mean.
        const double product = (a - x) * (b - y);
        square += product / count;
        fourth += product * product / count;
    }
    out.mean_95 = 1.96 * std::sqrt(spread / (count * (count - 1))) / t;
    out.rms = std::sqrt(std::max(square, 0.0)) / t;
    const double error_of_square = 1.96 * std::sqrt(std::max(fourth - square * square, 0.0) / count) / (t * t);
    // Of a square root; next to 0 the bound itself.
    out.rms_95 = out.rms * out.rms > error_of_square ? error_of_square / (2 * out.rms) : std::sqrt(error_of_square);
    return out;
}

nlohmann::json json_of(const Difference& d)
{
    return {{"error", d.mean}, {"error_95", d.mean_95}, {"rms", d.rms}, {"rms_95", d.rms_95}, {"truth", d.truth}};
}

nlohmann::json measure_reflectance(const Options& options)
{
    std::vector<std::string> names(options.models.size());
    std::vector<ModelSpec> models;
    std::map<VisibilityKind, PackedFabric> fabrics;
    for (std::size_t k = 0; k < options.models.size(); ++k) {
        models.push_back(model_of(options.models[k], names[k]));
        const VisibilityKind kind = models.back().visibility;
        if (!fabrics.count(kind)) fabrics.emplace(kind, baked(options, kind));
    }
    if (fabrics.empty()) fabrics.emplace(VisibilityKind::horizon8, baked(options, VisibilityKind::horizon8));
    const PackedFabric& cloth = fabrics.begin()->second;
    const ReliefTruth front(cloth, options.side), back(cloth, 1 - options.side);
    const glm::dvec3 sun(0.6, 0.35, std::sqrt(1 - 0.36 - 0.1225)); // 44 degrees from the normal

    nlohmann::json rows = nlohmann::json::array();
    for (const double angle : options.angles)
        for (const int texels : options.footprints) {
            const std::vector<Cell> places = cells(cloth.size, angle, texels, options.places);
            std::vector<Place> once(places.size()), all(places.size());
            tbb::parallel_for(std::size_t(0), places.size(), [&](std::size_t k) {
                const Cell& cell = places[k];
                TruthRandom random(k * 7919 + std::size_t(texels));
                for (int half = 0; half < 2; ++half)
                    for (int s = 0; s < options.samples; ++s) {
                        // Golden ratio and its like: even cover of the footprint, a new shift each half.
                        const double u = std::fmod((s + random.uniform()) / options.samples, 1.0), v = random.uniform();
                        const glm::dvec2 tile =
                            glm::dvec2(cell.footprint.tile) +
                            glm::dvec2(u - 0.5, v - 0.5) * glm::dvec2(cell.footprint.dx.x, cell.footprint.dy.y);
                        const ReliefTruth::Radiance r = front.path(back, tile, cell.footprint.base,
                                                                   glm::normalize(glm::dvec3(cell.o)), sun, random);
                        once[k].sky[half] += r.sky_once / options.samples;
                        once[k].sun[half] += r.sun_once / options.samples;
                        once[k].passes += r.passes / (2.0 * options.samples);
                        all[k].sky[half] += r.sky_all / options.samples;
                        all[k].sun[half] += r.sun_all / options.samples;
                    }
            });
            double gap_share = 0;
            for (const Place& place : once) gap_share += place.passes / double(once.size());

            nlohmann::json results = nlohmann::json::object();
            for (std::size_t m = 0; m < models.size(); ++m) {
                const f32::ClothMaps maps = maps_of(fabrics.at(models[m].visibility));
                const f32::ClothSettings& settings = models[m].settings;
                std::vector<Place> seen(places.size());
                tbb::parallel_for(std::size_t(0), places.size(), [&](std::size_t k) {
                    const Cell& cell = places[k];
                    for (int half = 0; half < 2; ++half)
                        for (int s = 0; s < options.samples; ++s) {
                            const f32::ClothRandom random{f32::cloth_hash(glm::uint(2 * k + std::size_t(half) + 1)),
                                                          glm::uint(s), 0};
                            const SkySample sample =
                                sample_sky(maps, options.side, cell.footprint, cell.o, settings, random);
                            if (sample.selection.passes) {
                                seen[k].passes += 1 / (2.0 * options.samples);
                                continue;
                            }
                            const f32::ClothShading shading = f32::cloth_shade_fabric(sample.selection, settings);
                            seen[k].sky[half] += double(sample.front.y) / options.samples;
                            seen[k].sun[half] +=
                                double(f32::cloth_shading_value(maps, shading, glm::vec3(sun), cell.o, settings).y) /
                                options.samples;
                        }
                });
                double passes = 0;
                for (const Place& place : seen) passes += place.passes / double(seen.size());
                results[names[m]] = {{"sky_once", json_of(compare(seen, once, &Place::sky))},
                                     {"sun_once", json_of(compare(seen, once, &Place::sun))},
                                     {"sky_all", json_of(compare(seen, all, &Place::sky))},
                                     {"sun_all", json_of(compare(seen, all, &Place::sun))},
                                     {"passes", passes}};
            }
            const auto mean = [](const std::vector<Place>& list, const double(Place::*member)[2]) {
                double sum = 0;
                for (const Place& place : list) sum += ((place.*member)[0] + (place.*member)[1]) / 2;
                return sum / double(list.size());
            };
            rows.push_back({{"angle", angle},
                            {"footprint", texels},
                            {"truth",
                             {{"sky_once", mean(once, &Place::sky)},
                              {"sky_all", mean(all, &Place::sky)},
                              {"sun_once", mean(once, &Place::sun)},
                              {"sun_all", mean(all, &Place::sun)},
                              {"passes", gap_share}}},
                            {"models", results}});
        }
    return {{"fabric", cloth.name},
            {"texels", {cloth.size.x, cloth.size.y}},
            {"gaps", cloth.gap_cover},
            {"places", options.places},
            {"samples_per_place", 2 * options.samples},
            {"sun", {sun.x, sun.y, sun.z}},
            {"cells", rows}};
}

int measure(int argc, char** argv)
{
    Options options;
    CLI::App app("Accuracy of the model's ingredients on one fabric.", "selvedge-ingredients");
    app.require_subcommand(1);
    bool json = true; // as the other programs have it; here there is nothing else
    const auto common = [&](CLI::App* command) {
        command->add_flag("--json", json, "the default");
        command->add_option("fabric", options.fabric, "FABRIC.json")->required();
        command->add_option("-D", options.overrides, "overrides of the fabric")->allow_extra_args(false);
        command->add_option("--resolution", options.resolution, "texels along the longer side");
        command->add_option("--places", options.places, "footprints; visibility: directions for each of 64 blocks");
    };
    CLI::App* visibility = app.add_subcommand("visibility", "V against exact rays");
    common(visibility);
    visibility->add_option("--kind", options.kinds, "none, horizon8, horizon16, cap, asg, asg-lsq, exact")->required();
    CLI::App* sweep = app.add_subcommand("sweep", "seconds of the horizon sweep and of brute force");
    common(sweep);
    CLI::App* reflectance =
        app.add_subcommand("reflectance", "effective reflectance against path tracing of the relief");
    common(reflectance);
    reflectance->add_option("--model", options.models, "NAME:KEY=VALUE,... as in a scene's model object")
        ->allow_extra_args(false);
    reflectance->add_option("--angles", options.angles, "view angles [deg]");
    reflectance->add_option("--footprints", options.footprints, "texels along a footprint's side");
    reflectance->add_option("--samples", options.samples, "of each half of each footprint");
    reflectance->add_option("--side", options.side, "0 front, 1 back")->check(CLI::Range(0, 1));
    if (!parse_command_line(app, argc, argv)) return 0;
    const nlohmann::json report = visibility->parsed() ? measure_visibility_kinds(options)
                                  : sweep->parsed()    ? measure_sweep(options)
                                                       : measure_reflectance(options);
    std::printf("%s\n", report.dump(1).c_str());
    return 0;
}

} // namespace

int main(int argc, char** argv)
{
    return selvedge::run_program("selvedge-ingredients", [&] { return measure(argc, argv); });
}
