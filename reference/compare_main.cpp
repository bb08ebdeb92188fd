// selvedge-compare: metrics of two pictures, a heat map, a verdict. Exit status as idiff's; nothing includes this file.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "bake/error.hpp"
#include "bake/image.hpp"
#include "bake/program.hpp"
#include "metrics.hpp"

namespace
{

using namespace selvedge;

constexpr const char* program = "selvedge-compare";

enum Status { same = 0, warning = 1, failure = 2, different_size = 3, file_error = 4 };

struct Threshold {
    const MetricRow* metric;
    double limit;
};

struct Options {
    std::string a, b, heatmap_path;
    Heatmap heatmap = Heatmap::relative;
    std::vector<Threshold> fail, warn;
    CompareOptions compare;
    bool json = false, quiet = false;
};

Threshold parse_threshold(const std::string& option, const std::string& text)
{
    const auto split = text.find('=');
    const std::string name = text.substr(0, split);
    const auto& rows = metric_rows();
    const auto row = std::find_if(rows.begin(), rows.end(), [&](const MetricRow& r) { return name == r.name; });
    if (split == std::string::npos || row == rows.end()) {
        std::string known;
        for (const MetricRow& r : rows) known += (known.empty() ? "" : ", ") + std::string(r.name);
        throw UsageError("%s: found %s, expected METRIC=VALUE with a metric of %s", option.c_str(), text.c_str(),
                         known.c_str());
    }
    const std::string number = text.substr(split + 1);
    char* end = nullptr;
    const double limit = std::strtod(number.c_str(), &end);
    if (number.empty() || *end != '\0' || !(limit >= 0.0))
        throw UsageError("%s: found %s, expected a number of 0 or more after =", option.c_str(), text.c_str());
    return {&*row, limit};
}

// CLI::Range lets NaN through.
CLI::Validator between(double low, double high)
{
    return {[=](std::string& text) {
                const double value = std::strtod(text.c_str(), nullptr);
                return value >= low && value <= high
                           ? ""
                           : format_text("found %s, expected %g to %g", text.c_str(), low, high);
            },
            ""};
}

std::string help_footer()
{
    std::string text = "Metrics (A against the reference B; scene-linear, R, G and B of all pixels):\n";
    for (const MetricRow& row : metric_rows()) text += format_text("  %-26s %s\n", row.name, row.help);
    return text +
           "relmse_..., mean_relative_bias_sigma and z_... need variance.R, .G, .B in A or B (or both).\n"
           "z = (a - b) / sqrt(variance of a + variance of b), each channel of each pixel by itself, where a variance "
           "is not\n"
           "zero or a and b differ. Variances estimated from 16 blocks give about 0.005 outliers instead of 0.0027.\n"
           "\n"
           "Heat maps: relative  root of the pixel's relmse term, logarithmic, 0.001 black to 1 white (magma)\n"
           "           flip      LDR-FLIP, 0 black to 1 white (magma)\n"
           "           z         mean z of the channels, -5 blue (A darker) over white to 5 red\n"
           "           difference  mean of (a - b) / sqrt(b^2 + 0.01), -0.5 blue to 0.5 red\n"
           "           Pixels with NaN or Inf are green.\n"
           "\n"
           "Exit status as idiff's: 0 same (no metric beyond a threshold), 1 beyond a --warn, 2 beyond a --fail, or "
           "NaN or\n"
           "Inf in a picture, or wrong usage, 3 different sizes, 4 a file cannot be read or written. Signed metrics "
           "are\n"
           "compared without their sign. With neither --fail nor --warn, as in idiff, --fail max_abs=1e-6 holds.";
}

Options parse_options(int argc, char** argv)
{
    Options options;
    CLI::App app("Compare picture A with the reference picture B.", program);
    const std::map<std::string, Heatmap> heatmaps{{"relative", Heatmap::relative},
                                                  {"flip", Heatmap::flip},
                                                  {"z", Heatmap::z},
                                                  {"difference", Heatmap::difference}};
    std::vector<std::string> fail, warn;
    std::string kind = "relative";
    bool show_version = false;
    auto* a = app.add_option("A", options.a, "picture (EXR, HDR, PNG, ...)");
    auto* b = app.add_option("B", options.b, "picture that A is held to");
    app.add_option("--heatmap", options.heatmap_path, "write a PNG of where they differ")->type_name("OUT.png");
    app.add_option("--heatmap-kind", kind, "relative, flip, z or difference (default relative)")->type_name("KIND");
    app.add_option("--fail", fail, "status 2 where METRIC is beyond VALUE; repeatable")
        ->type_name("METRIC=VALUE")
        ->allow_extra_args(false);
    app.add_option("--warn", warn, "status 1 where METRIC is beyond VALUE; repeatable")
        ->type_name("METRIC=VALUE")
        ->allow_extra_args(false);
    app.add_option("--exposure", options.compare.exposure, "stops, for FLIP's display transform (default 0)")
        ->type_name("STOPS")
        ->check(between(-50.0, 50.0));
    app.add_option("--ppd", options.compare.pixels_per_degree,
                   "pixels per degree of visual angle, for FLIP (default 67.02: 0.7 m from 3840 pixels on 0.7 m)")
        ->type_name("PPD")
        ->check(between(1.0, 1000.0));
    app.add_flag("--json", options.json, "one JSON object on stdout");
    app.add_flag("-q,--quiet", options.quiet, "no table");
    app.add_flag("-V,--version", show_version, "version and exit");
    app.footer(help_footer());
    if (!parse_command_line(app, argc, argv)) std::exit(0);
    if (show_version) {
        std::fputs(version_text(program, {}).c_str(), stdout);
        std::exit(0);
    }
    if (!*a || !*b) throw UsageError("found %d pictures, expected two, A and B", *a ? 1 : 0);
    const auto found = heatmaps.find(kind);
    if (found == heatmaps.end())
        throw UsageError("--heatmap-kind: found %s, expected relative, flip, z or difference", kind.c_str());
    options.heatmap = found->second;
    for (const std::string& text : fail) options.fail.push_back(parse_threshold("--fail", text));
    for (const std::string& text : warn) options.warn.push_back(parse_threshold("--warn", text));
    if (fail.empty() && warn.empty()) options.fail.push_back(parse_threshold("--fail", "max_abs=1e-6"));
    return options;
}

// What is beyond its limit, in words. A metric that is not available is beyond every limit.
std::vector<std::string> beyond(const std::vector<Threshold>& thresholds, const Comparison& comparison)
{
    std::vector<std::string> found;
    for (const auto& [metric, limit] : thresholds) {
        const double value = metric->value(comparison);
        if (std::isnan(value))
            found.push_back(format_text("%s is not available, expected at most %g", metric->name, limit));
        else if (std::abs(value) > limit)
            found.push_back(format_text("%s is %g, expected at most %g", metric->name, value, limit));
    }
    return found;
}

void print_json(const Options& options, const Image& image, const Comparison& comparison, Status status,
                const std::vector<std::string>& failed, const std::vector<std::string>& warned)
{
    nlohmann::ordered_json json{{"a", options.a}, {"b", options.b}, {"size", {image.width, image.height}}};
    for (const MetricRow& row : metric_rows()) {
        const double value = row.value(comparison);
        json[row.name] = std::isnan(value) ? nlohmann::ordered_json() : nlohmann::ordered_json(value);
    }
    json["worst_pixel"] = {comparison.worst_x, comparison.worst_y};
    json["values"] = comparison.values;
    json["z_values"] = comparison.z_values;
    json["bad_pixels"] = {{"a", comparison.bad_a}, {"b", comparison.bad_b}};
    json["exposure"] = options.compare.exposure;
    json["pixels_per_degree"] = options.compare.pixels_per_degree;
    json["verdict"] = status == same ? "same" : status == warning ? "warning" : "failure";
    json["failed"] = failed;
    json["warned"] = warned;
    std::printf("%s\n", json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
}

void print_table(const Comparison& comparison)
{
    for (const MetricRow& row : metric_rows()) {
        const double value = row.value(comparison);
        if (!std::isnan(value)) std::printf("%-26s %12.6g\n", row.name, value);
    }
    std::printf("%-26s %8d, %d\n", "worst pixel (x, y)", comparison.worst_x, comparison.worst_y);
}

int compare(const Options& options, int argc, char** argv)
{
    const Image a = read_image(options.a), b = read_image(options.b);
    if (a.width != b.width || a.height != b.height) {
        std::fprintf(stderr, "%s: %s: found %d x %d pixels, expected %d x %d as in %s\n", program, options.a.c_str(),
                     a.width, a.height, b.width, b.height, options.b.c_str());
        return different_size;
    }
    const Comparison comparison = compare_images(a, b, options.a, options.b, options.compare);
    if (!options.heatmap_path.empty()) {
        Image picture = heatmap(a, b, options.a, options.b, comparison, options.heatmap);
        picture.metadata = provenance(argc, argv);
        write_png(options.heatmap_path, picture);
    }

    std::vector<std::string> failed = beyond(options.fail, comparison);
    const std::vector<std::string> warned = beyond(options.warn, comparison);
    for (const auto& [path, count] : {std::pair(options.a, comparison.bad_a), std::pair(options.b, comparison.bad_b)})
        if (count > 0)
            failed.push_back(format_text("%s: NaN, Inf or negative variance in %zu pixels (first bad pixel %d, %d), "
                                         "expected none",
                                         path.c_str(), count, comparison.first_bad_x, comparison.first_bad_y));
    const Status status = !failed.empty() ? failure : !warned.empty() ? warning : same;
    if (options.json)
        print_json(options, a, comparison, status, failed, warned);
    else if (!options.quiet)
        print_table(comparison);
    for (const std::string& text : failed) std::fprintf(stderr, "%s: failure: %s\n", program, text.c_str());
    for (const std::string& text : warned) std::fprintf(stderr, "%s: warning: %s\n", program, text.c_str());
    return status;
}

} // namespace

int main(int argc, char** argv)
{
    return run_program(program, [&] {
        const Options options = parse_options(argc, argv);
        try {
            return compare(options, argc, argv);
        } catch (const InputError& error) {
            std::fprintf(stderr, "%s: %s\n", program, error.what());
            return static_cast<int>(file_error);
        }
    });
}
