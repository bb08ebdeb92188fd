// selvedge-bake: bakes one fabric into the cache, reports, draws its maps. Exit 0 done, 1 input or I/O failed, 2 wrong
// usage.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "bake/bake.hpp"
#include "bake/energy.hpp"
#include "bake/error.hpp"
#include "bake/image.hpp"
#include "bake/map_sheet.hpp"
#include "bake/program.hpp"
#include "bake/weaves.hpp"
#include "bake/wif.hpp"

namespace
{

using namespace selvedge;

struct Options {
    std::string input, output_folder, preview, export_draft, visibility;
    Overrides overrides;
    int resolution = 0;
    bool albedo = false, force = false, json = false, quiet = false, list = false, version = false;
};

Options parse_options(int argc, char** argv, bool& done)
{
    Options options;
    CLI::App app("Bakes a fabric: pattern and yarns to feature maps, visibility and slope mips, into the cache.",
                 "selvedge-bake");
    app.add_option("input", options.input,
                   "FABRIC.json, DRAFT.wif, ROWS.txt of x and dots, or a knit: .chart, .csv, .png, .k, .knitout");
    app.add_option("-o,--output", options.output_folder, "folder for maps.exr and fabric.json (besides the cache)");
    app.add_option("--resolution", options.resolution, "texels along the longer side of the repeat (16 to 2048)")
        ->check(CLI::Range(16, 2048));
    app.add_option("--visibility", options.visibility,
                   "horizon8 (default), horizon16, cap, asg, asg-lsq, exact: how yarns hide light from each other");
    app.add_option("-D", options.overrides, "path.to.key=value: overrides a value of the fabric")
        ->allow_extra_args(false);
    app.add_option("--preview", options.preview, "PNG: all maps on one sheet, front above, back below");
    app.add_option("--export-draft", options.export_draft, "WIF: the woven pattern");
    app.add_flag("--albedo", options.albedo,
                 "what the cloth reflects and lets through under a uniform sky, by angle, front and back");
    app.add_flag("--force", options.force, "bake even when the cache has it");
    app.add_flag("--json", options.json, "one JSON object on stdout");
    app.add_flag("--list", options.list, "the built-in weaves and knits");
    app.add_flag("-q,--quiet", options.quiet, "no warnings, no summary");
    app.add_flag("-V,--version", options.version, "version, git revision, libraries");
    if (!parse_command_line(app, argc, argv)) {
        done = true;
        return options;
    }
    if (options.version || options.list) {
        std::string text = options.version ? version_text("selvedge-bake", image_library_versions()) : "";
        if (options.list)
            for (const auto& list : {builtin_weaves(), builtin_knits()})
                for (const std::string& line : list) text += line + "\n";
        std::fputs(text.c_str(), stdout);
        done = true;
    } else if (options.input.empty()) {
        throw UsageError("no input, expected FABRIC.json, DRAFT.wif, ROWS.txt or a knitting chart");
    }
    return options;
}

nlohmann::json report_json(const PackedFabric& fabric, const BakeReport& report, const VisibilityError& error)
{
    return {{"fabric", fabric.name},
            {"texels", {fabric.size.x, fabric.size.y}},
            {"tile", {fabric.tile_m.x, fabric.tile_m.y}},
            {"seconds",
             {{"pattern", report.pattern_seconds},
              {"maps", report.maps_seconds},
              {"visibility", report.visibility_seconds},
              {"normals", report.normals_seconds},
              {"total", report.total_seconds}}},
            {"bytes", {{"memory", report.memory_bytes}, {"disk", report.disk_bytes}}},
            {"visibility",
             {{"kind", visibility_name(fabric.visibility)},
              {"bytes_per_texel", fabric.visibility_bytes_per_texel()},
              {"rms_error", error.rms},
              {"directions", error.directions},
              {"texels", 2 * error.texels}}},
            {"cached", report.cached},
            {"baked", report.baked},
            {"sides", fabric.back_shift ? 1 : 2},
            {"coverage", {{"warp", fabric.warp_cover}, {"weft", fabric.weft_cover}, {"gap", fabric.gap_cover}}},
            {"yarns", fabric.yarn_names},
            {"warnings", fabric.warnings}};
}

// Spacings and widths that the fabric states or that follow from its yarns [m].
nlohmann::json lengths_json(const Fabric& fabric)
{
    const auto yarn = [](const YarnSpec& spec) {
        return nlohmann::json{{"spacing", spec.spacing_m}, {"width", spec.width_m}};
    };
    if (!fabric.knit) return {{"warp", yarn(fabric.warp)}, {"weft", yarn(fabric.weft)}};
    return {{"wale_spacing", fabric.wale_spacing_m},
            {"course_spacing", fabric.course_spacing_m},
            {"yarn", {{"width", fabric.weft.width_m}}}};
}

constexpr int albedo_angles_deg[] = {0, 15, 30, 45, 60, 75, 85};

// [{"side", "angle", "reflectance", "transmittance", "straight", "standard_error"}, ...]
nlohmann::json albedo_json(const PackedFabric& fabric)
{
    nlohmann::json rows = nlohmann::json::array();
    const auto rgb = [](glm::dvec3 c) { return nlohmann::json{c.x, c.y, c.z}; };
    for (int side = 0; side < 2; ++side)
        for (const int angle : albedo_angles_deg) {
            const ClothAlbedo albedo = cloth_albedo(fabric, side, angle);
            rows.push_back({{"side", side == 0 ? "front" : "back"},
                            {"angle", angle},
                            {"reflectance", rgb(albedo.reflectance)},
                            {"transmittance", rgb(albedo.transmittance)},
                            {"straight", albedo.straight},
                            {"standard_error", albedo.standard_error}});
        }
    return rows;
}

void print_albedo(const nlohmann::json& rows)
{
    std::printf("side   angle  reflectance             transmittance           straight  +-\n");
    for (const nlohmann::json& row : rows) {
        const auto number = [&row](const char* key, std::size_t c) { return row[key][c].get<double>(); };
        std::printf("%-5s  %4d   %6.4f  %6.4f  %6.4f  %6.4f  %6.4f  %6.4f  %6.4f    %6.4f\n",
                    row["side"].get<std::string>().c_str(), row["angle"].get<int>(), number("reflectance", 0),
                    number("reflectance", 1), number("reflectance", 2), number("transmittance", 0),
                    number("transmittance", 1), number("transmittance", 2), row["straight"].get<double>(),
                    row["standard_error"].get<double>());
    }
}

void print_warnings(const Options& options, const std::vector<std::string>& warnings)
{
    if (!options.quiet)
        for (const std::string& warning : warnings)
            std::fprintf(stderr, "selvedge-bake: %s: warning: %s\n", options.input.c_str(), warning.c_str());
}

int bake(int argc, char** argv)
{
    bool done = false;
    const Options options = parse_options(argc, argv, done);
    if (done) return 0;
    BakeOptions bake_options;
    bake_options.resolution = options.resolution;
    bake_options.force = options.force;
    if (!options.visibility.empty()) bake_options.visibility = parse_visibility(options.visibility);

    const Fabric fabric = load_fabric(options.input, options.overrides);
    if (!options.export_draft.empty()) {
        if (fabric.draft.ends.empty())
            throw InputError(options.input, 0, "not woven, expected a woven pattern for --export-draft");
        const std::string text = format_wif(fabric.draft, version());
        write_file(options.export_draft, text.data(), text.size());
        if (options.preview.empty() && options.output_folder.empty() && !options.json) {
            print_warnings(options, fabric.warnings); // nothing else was asked for: converting a draft needs no bake
            return 0;
        }
    }
    BakeReport report;
    const PackedFabric packed = bake_fabric(fabric, bake_options, &report);
    print_warnings(options, packed.warnings);
    if (!options.preview.empty()) {
        Image sheet = draw_map_sheet(packed);
        sheet.metadata = provenance(argc, argv);
        write_png(options.preview, sheet);
    }
    nlohmann::json json;
    if (options.json || !options.output_folder.empty()) json = report_json(packed, report, measure_visibility(packed));
    if (!json.is_null()) json["lengths"] = lengths_json(fabric);
    nlohmann::json albedo;
    if (options.albedo) {
        albedo = albedo_json(packed);
        if (!json.is_null()) json["albedo"] = albedo;
    }
    if (!options.output_folder.empty()) {
        std::error_code error;
        std::filesystem::create_directories(options.output_folder, error);
        if (error) throw InputError(options.output_folder, 0, "cannot be made: %s", error.message().c_str());
        write_exr(options.output_folder + "/maps.exr", map_layers(packed), provenance(argc, argv));
        const std::string text = json.dump(2) + "\n";
        write_file(options.output_folder + "/fabric.json", text.data(), text.size());
    }
    if (options.json)
        std::printf("%s\n", json.dump().c_str());
    else if (!options.quiet)
        std::printf("%s: %d x %d texels of %.4g x %.4g mm, warp %.1f %%, weft %.1f %%, gaps %.1f %%; %s %.3f s\n",
                    packed.name.c_str(), packed.size.x, packed.size.y, 1e3 * static_cast<double>(packed.tile_m.x),
                    1e3 * static_cast<double>(packed.tile_m.y), 100 * static_cast<double>(packed.warp_cover),
                    100 * static_cast<double>(packed.weft_cover), 100 * static_cast<double>(packed.gap_cover),
                    report.cached ? "from the cache in" : "baked in", report.total_seconds);
    if (options.albedo && !options.json) print_albedo(albedo);
    return 0;
}

} // namespace

int main(int argc, char** argv)
{
    return selvedge::run_program("selvedge-bake", [&] { return bake(argc, argv); });
}
