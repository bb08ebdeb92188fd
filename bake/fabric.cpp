// bake/fabric.cpp: fabric JSON and bare drafts to a Fabric; yarn types.
#include "fabric.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>

#include <glm/gtc/constants.hpp>

#include "chart.hpp"
#include "energy.hpp"
#include "error.hpp"
#include "knitout.hpp"
#include "params.hpp"
#include "weaves.hpp"
#include "wif.hpp"

namespace selvedge
{

namespace
{

constexpr struct {
    VisibilityKind kind;
    const char* name;
} visibility_names[] = {{VisibilityKind::horizon8, "horizon8"}, {VisibilityKind::horizon16, "horizon16"},
                        {VisibilityKind::cap, "cap"},           {VisibilityKind::asg, "asg"},
                        {VisibilityKind::asg_lsq, "asg-lsq"},   {VisibilityKind::exact, "exact"}};

// Mean of what the draft states; 0 where it states nothing.
float mean_length(const std::vector<DraftThread>& threads, float DraftThread::*member)
{
    double sum = 0;
    std::size_t count = 0;
    for (const DraftThread& thread : threads)
        if (thread.*member > 0) {
            sum += static_cast<double>(thread.*member);
            ++count;
        }
    return count ? static_cast<float>(sum / static_cast<double>(count)) : 0.0f;
}

// What the fabric does not state itself: from the draft, else in proportion to the spacing.
void complete_lengths(YarnSpec& yarn, const std::vector<DraftThread>& threads, bool has_spacing, bool has_width)
{
    const float spacing = mean_length(threads, &DraftThread::spacing_m);
    const float thickness = mean_length(threads, &DraftThread::thickness_m);
    if (!has_spacing && spacing > 0) yarn.spacing_m = std::clamp(spacing, 2e-5f, 0.05f);
    if (!has_width) yarn.width_m = !has_spacing && thickness > 0 ? thickness : 0.9f * yarn.spacing_m;
}

std::optional<glm::vec3> optional_colour(const JsonValue& value, const char* key)
{
    return value.has(key) ? std::optional(value[key].number_or_vector3(0, 1)) : std::nullopt;
}

void parse_yarn(const JsonValue& value, YarnSpec& yarn)
{
    value.expect_object({"spacing", "width", "tex", "fibre", "aspect", "section", "plies", "ply_twist", "fibre_twist",
                         "crimp", "albedo", "albedo_transmission", "diffuse", "diffuse_transmission", "roughness",
                         "roughness_transmission", "thickness", "diffuse_mix"});
    for (const YarnParam& row : yarn_params)
        if (value.has(row.key))
            yarn.*row.member = static_cast<float>(
                value[row.key].number(static_cast<double>(row.low) * (1 - 1e-6), static_cast<double>(row.high)));
    yarn.plies = value.integer("plies", yarn.plies, 1, ply_limit);
    if (value.has("crimp")) yarn.crimp = static_cast<float>(value["crimp"].number(0, 1));
    if (value.has("section")) {
        std::vector<const char*> names;
        for (const Section& row : yarn_sections) names.push_back(row.name);
        const std::string name = value["section"].choice(names);
        for (const Section& row : yarn_sections)
            if (name == row.name) yarn.section = row.section;
    }
    if (yarn.section == YarnSection::racetrack && yarn.aspect > 1)
        value[value.has("aspect") ? "aspect" : "section"].fail(
            "found %.3g, expected at most 1: a race-track is wider than high", double(yarn.aspect));
    if (value.has("fibre")) {
        std::vector<const char*> names;
        for (const Fibre& row : fibres) names.push_back(row.name);
        yarn.fibre = value["fibre"].choice(names);
    }
    if (value.has("tex")) {
        yarn.tex = static_cast<float>(value["tex"].number(0.1, 1e5));
        if (!value.has("width")) yarn.width_m = std::clamp(width_of_tex(yarn, *yarn.tex), 1e-5f, 0.05f);
    }
    if (value.has("roughness_transmission"))
        yarn.roughness_transmission = static_cast<float>(value["roughness_transmission"].number(0.01, 1));
    if (const auto albedo = optional_colour(value, "albedo")) yarn.albedo = *albedo;
    yarn.albedo_transmission = optional_colour(value, "albedo_transmission");
    yarn.diffuse = optional_colour(value, "diffuse");
    yarn.diffuse_transmission = optional_colour(value, "diffuse_transmission");

    // What the fabric leaves open keeps energy by itself (shade_yarn).
    if (!yarn.diffuse && !yarn.diffuse_transmission) return;
    const SlabTable slab = slab_table(yarn);
    const YarnEnergy energy = most_sent_out(shade_yarn(yarn, glm::vec3(1), slab), slab);
    constexpr double rounding = 1e-3; // of the quadrature
    const char* channels[] = {"red", "green", "blue"};
    if (energy.most > 1 + rounding)
        value[value.has("diffuse") ? "diffuse" : "diffuse_transmission"].fail(
            "the yarn sends out %.3g of the %s light that it receives, seen at %.0f degrees: %.3g diffuse, %.3g "
            "scattered "
            "once by the fibres, %.3g between them; expected at most 1 (without diffuse it follows from the albedo)",
            energy.most, channels[energy.channel], energy.angle_deg, energy.diffuse, energy.slab, energy.unscattered);
}

bool states_width(const JsonValue& yarn)
{
    return yarn.has("width") || yarn.has("tex");
}

std::string stem(const std::string& path)
{
    return std::filesystem::path(path).stem().string();
}

void take_draft(Fabric& fabric, Draft draft)
{
    fabric.draft = std::move(draft);
    for (const std::string& warning : fabric.draft.warnings)
        fabric.warnings.push_back(std::filesystem::path(fabric.pattern).filename().string() + ": " + warning);
}

// A knit's pattern, loops and yarn. What is not stated follows from the yarn's width d: wales 4 d and courses 3.364 d
// apart, Peirce's compact loop.
void parse_knit(const JsonValue& value, Fabric& fabric)
{
    for (const char* key : {"pattern", "warp", "weft"})
        if (value.has(key)) value[key].fail("stands beside \"knit\", expected one of both: a knit has a \"yarn\"");
    const JsonValue knit = value["knit"];
    if (knit.is_text()) {
        fabric.pattern = knit.text();
        fabric.knit = builtin_knit(fabric.pattern, value.path(), knit.line());
    } else {
        knit.expect_object({"chart", "knitout"});
        if (knit.raw().size() != 1) knit.fail("%zu keys, expected one of chart, knitout", knit.raw().size());
        const bool is_chart = knit.has("chart");
        fabric.pattern = knit[is_chart ? "chart" : "knitout"].file();
        fabric.knit = is_chart ? read_chart(fabric.pattern) : read_knitout(fabric.pattern);
        for (const std::string& warning : fabric.knit->warnings)
            fabric.warnings.push_back(std::filesystem::path(fabric.pattern).filename().string() + ": " + warning);
    }
    YarnSpec& yarn = fabric.weft;
    yarn.aspect = 0.85f;
    const bool given = value.has("yarn");
    if (given) {
        for (const char* key : {"spacing", "crimp"})
            if (value["yarn"].has(key))
                value["yarn"][key].fail("a woven yarn's, expected wale_spacing and course_spacing beside \"yarn\"");
        if (value["yarn"].has("section")) value["yarn"]["section"].fail("a woven yarn's: knitted yarns are ellipses");
        parse_yarn(value["yarn"], yarn);
    }
    const bool has_width = given && states_width(value["yarn"]), has_wale = value.has("wale_spacing"),
               has_course = value.has("course_spacing");
    fabric.wale_spacing_m = has_wale ? float(value["wale_spacing"].number(4e-5, 0.1)) : 0;
    fabric.course_spacing_m = has_course ? float(value["course_spacing"].number(4e-5, 0.1)) : 0;
    if (!has_width) {
        if (has_wale || has_course)
            yarn.width_m =
                std::clamp(has_wale ? fabric.wale_spacing_m / 4 : fabric.course_spacing_m / 3.364f, 1e-5f, 0.05f);
        else
            yarn.width_m = 0.0003f;
    }
    if (!has_wale) fabric.wale_spacing_m = 4 * yarn.width_m;
    if (!has_course) fabric.course_spacing_m = 3.364f * yarn.width_m;
    if (value.has("loop_length")) {
        const double shortest = 1.2 * double(fabric.wale_spacing_m + fabric.course_spacing_m);
        fabric.loop_length_m = float(value["loop_length"].number(shortest, 8 * shortest));
    }
}

glm::ivec3 srgb8(glm::vec3 linear)
{
    glm::ivec3 out;
    for (int c = 0; c < 3; ++c) {
        const float v = std::clamp(linear[c], 0.0f, 1.0f);
        out[c] = static_cast<int>(
            std::lround(255.0f * (v <= 0.0031308f ? v * 12.92f : 1.055f * std::pow(v, 1 / 2.4f) - 0.055f)));
    }
    return out;
}

} // namespace

Fabric parse_fabric(const JsonValue& value)
{
    value.expect_object({"$schema", "name", "pattern", "resolution", "use_draft_colours", "warp", "weft", "visibility",
                         "irregularity", "comment", "knit", "yarn", "wale_spacing", "course_spacing", "loop_length"});
    Fabric fabric;
    fabric.path = value.path();
    fabric.name = value.text("name", stem(value.path()));
    fabric.resolution = value.integer("resolution", fabric.resolution, 16, 2048);
    fabric.use_draft_colours = value.boolean("use_draft_colours", false);
    if (value.has("irregularity")) {
        const JsonValue irregularity = value["irregularity"];
        irregularity.expect_object({"twist", "length"});
        fabric.irregularity_deg = float(irregularity.number("twist", double(fabric.irregularity_deg), 0, 45));
        fabric.irregularity_length_m =
            float(irregularity.number("length", double(fabric.irregularity_length_m), 1e-5, 1));
    }
    if (value.has("visibility"))
        fabric.visibility =
            parse_visibility(value["visibility"].choice({"horizon8", "horizon16", "cap", "asg", "asg-lsq", "exact"}));

    if (value.has("knit")) {
        parse_knit(value, fabric);
        return fabric;
    }
    for (const char* key : {"yarn", "wale_spacing", "course_spacing", "loop_length"})
        if (value.has(key)) value[key].fail("a knit's, expected \"knit\" beside it");
    const JsonValue pattern = value["pattern"];
    if (pattern.is_text()) {
        fabric.pattern = pattern.text();
        take_draft(fabric, builtin_weave(fabric.pattern, value.path(), pattern.line()));
    } else {
        pattern.expect_object({"wif", "text", "rows"});
        if (pattern.raw().size() != 1) pattern.fail("%zu keys, expected one of wif, text, rows", pattern.raw().size());
        if (pattern.has("rows")) {
            if (!pattern["rows"].is_array()) pattern["rows"].fail("no list, expected rows such as \"x.\", \".x\"");
            std::vector<WeaveRow> rows;
            for (const JsonValue& row : pattern["rows"].elements()) rows.push_back({row.text(), row.line()});
            fabric.pattern = "rows";
            take_draft(fabric, weave_from_rows(rows, value.path()));
        } else if (pattern.has("text")) {
            fabric.pattern = pattern["text"].file();
            take_draft(fabric, read_weave_text(fabric.pattern));
        } else {
            fabric.pattern = pattern["wif"].file();
            take_draft(fabric, read_wif(fabric.pattern));
        }
    }
    for (const bool is_warp : {true, false}) {
        const char* key = is_warp ? "warp" : "weft";
        YarnSpec& yarn = is_warp ? fabric.warp : fabric.weft;
        const bool given = value.has(key);
        if (given) parse_yarn(value[key], yarn);
        complete_lengths(yarn, is_warp ? fabric.draft.ends : fabric.draft.picks, given && value[key].has("spacing"),
                         given && states_width(value[key]));
    }
    return fabric;
}

Fabric load_fabric(const std::string& path, const Overrides& overrides)
{
    std::string extension = std::filesystem::path(path).extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    const char* knit_key = extension == ".k" || extension == ".knitout"                          ? "knitout"
                           : extension == ".png" || extension == ".csv" || extension == ".chart" ? "chart"
                                                                                                 : nullptr;
    if (!knit_key && extension != ".wif" && extension != ".txt") return parse_fabric(JsonValue::read(path, overrides));

    // A bare draft or chart is the fabric that says nothing but its pattern.
    const std::string name = std::filesystem::path(path).filename().string();
    if (knit_key) {
        const nlohmann::json bare = {{"name", stem(path)}, {"knit", {{knit_key, name}}}, {"yarn", {{"albedo", 0.9}}}};
        return parse_fabric(
            JsonValue::parse(bare.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace), path, overrides));
    }
    const nlohmann::json bare = {{"name", stem(path)},
                                 {"pattern", {{extension == ".wif" ? "wif" : "text", name}}},
                                 {"use_draft_colours", true},
                                 {"warp", {{"albedo", 0.9}}},
                                 {"weft", {{"albedo", 0.9}}}};
    return parse_fabric(
        JsonValue::parse(bare.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace), path, overrides));
}

YarnTypes yarn_types(const Fabric& fabric)
{
    YarnTypes out;
    if (fabric.knit) {
        for (const glm::vec3 tint : fabric.knit->colours) {
            const glm::ivec3 bits = srgb8(tint);
            out.types.push_back({false, tint,
                                 format_text("yarn #%02x%02x%02x", static_cast<unsigned>(bits.x),
                                             static_cast<unsigned>(bits.y), static_cast<unsigned>(bits.z))});
        }
        if (out.types.empty()) out.types = {{false, glm::vec3(1), "yarn"}};
        return out;
    }
    const Draft& draft = fabric.draft;
    if (!fabric.use_draft_colours || draft.colours.empty()) {
        out.types = {{true, glm::vec3(1), "warp"}, {false, glm::vec3(1), "weft"}};
        out.end_type.assign(draft.ends.size(), 0);
        out.pick_type.assign(draft.picks.size(), 1);
        return out;
    }
    const auto colour_of = [&](const DraftThread& thread) {
        return thread.colour >= 0 ? draft.colours[static_cast<std::size_t>(thread.colour)] : glm::vec3(1);
    };
    // Coarser and coarser 8-bit colours until they fit; the first thread of a bin gives its colour.
    for (int drop = 0;; ++drop) {
        std::map<std::tuple<bool, int, int, int>, int> bins;
        out = {};
        const auto place = [&](const DraftThread& thread, bool warp) {
            const glm::vec3 tint = colour_of(thread);
            const glm::ivec3 bits = srgb8(tint);
            const auto key = std::make_tuple(warp, bits.x >> drop, bits.y >> drop, bits.z >> drop);
            const auto [bin, is_new] = bins.try_emplace(key, static_cast<int>(out.types.size()));
            if (is_new)
                out.types.push_back(
                    {warp, tint,
                     format_text("%s #%02x%02x%02x", warp ? "warp" : "weft", static_cast<unsigned>(bits.x),
                                 static_cast<unsigned>(bits.y), static_cast<unsigned>(bits.z))});
            return bin->second;
        };
        for (const DraftThread& end : draft.ends) out.end_type.push_back(place(end, true));
        for (const DraftThread& pick : draft.picks) out.pick_type.push_back(place(pick, false));
        if (static_cast<int>(out.types.size()) <= yarn_type_limit) {
            if (drop > 0)
                out.warning =
                    format_text("more than %d yarn colours: merged to %zu", yarn_type_limit, out.types.size());
            return out;
        }
    }
}

VisibilityKind parse_visibility(const std::string& word)
{
    std::string list;
    for (const auto& row : visibility_names) {
        if (word == row.name) return row.kind;
        list += (list.empty() ? "" : ", ") + std::string(row.name);
    }
    throw UsageError("visibility %s, expected one of %s", word.c_str(), list.c_str());
}

glm::vec2 ply_radii(int plies)
{
    constexpr float compression = 1.12f; // plies in contact flatten: radius over that of round plies that just touch
    if (plies == 1) return {1, 0};
    const float s = std::sin(glm::pi<float>() / static_cast<float>(plies));
    const float radius = std::min(compression * s / (1 + s), 0.9f);
    return {radius, 1 - radius};
}

float width_of_tex(const YarnSpec& yarn, float tex)
{
    float area = 0; // of the section, m^2; 1 tex = 1e-6 kg/m
    for (const Fibre& row : fibres)
        if (yarn.fibre == row.name) area = 1e-6f * tex / (row.density_kg_m3 * row.packing);
    const float ply = ply_radii(yarn.plies).x, filled = static_cast<float>(yarn.plies) * ply * ply;
    const float quarter_pi = glm::pi<float>() / 4, a = yarn.aspect;
    // Of a section of width 1.
    const float section = yarn.section == YarnSection::ellipse ? quarter_pi * a : a * (1 - a * (1 - quarter_pi));
    return std::sqrt(area / (filled * section));
}

const char* visibility_name(VisibilityKind kind)
{
    for (const auto& row : visibility_names)
        if (row.kind == kind) return row.name;
    return "?";
}

} // namespace selvedge
