// bake/fabric.cpp: fabric JSON and bare drafts to a Fabric; yarn types.
#include "fabric.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>

#include "error.hpp"
#include "params.hpp"
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
    value.expect_object({"spacing", "width", "aspect", "plies", "ply_twist", "fibre_twist", "crimp", "albedo",
                         "albedo_transmission", "diffuse", "diffuse_transmission", "roughness",
                         "roughness_transmission", "thickness", "diffuse_mix"});
    for (const YarnParam& row : yarn_params)
        if (value.has(row.key))
            yarn.*row.member = static_cast<float>(
                value[row.key].number(static_cast<double>(row.low) * (1 - 1e-6), static_cast<double>(row.high)));
    yarn.plies = value.integer("plies", yarn.plies, 1, ply_limit);
    if (value.has("crimp")) yarn.crimp = static_cast<float>(value["crimp"].number(0, 1));
    if (value.has("roughness_transmission"))
        yarn.roughness_transmission = static_cast<float>(value["roughness_transmission"].number(0.01, 1));
    if (const auto albedo = optional_colour(value, "albedo")) yarn.albedo = *albedo;
    yarn.albedo_transmission = optional_colour(value, "albedo_transmission");
    yarn.diffuse = optional_colour(value, "diffuse");
    yarn.diffuse_transmission = optional_colour(value, "diffuse_transmission");

    // Energy: a sufficient bound, math.md 4.2.
    const glm::vec3 none(0);
    const glm::vec3 total = glm::max(yarn.albedo, yarn.albedo_transmission.value_or(yarn.albedo)) +
                            yarn.diffuse.value_or(none) + yarn.diffuse_transmission.value_or(none);
    const char* channels[] = {"red", "green", "blue"};
    for (int c = 0; c < 3; ++c)
        if ((yarn.diffuse || yarn.diffuse_transmission) && total[c] > 1.0001f)
            value[value.has("diffuse") ? "diffuse" : "diffuse_transmission"].fail(
                "albedo + diffuse + diffuse_transmission is %.3g in %s, expected at most 1 (without diffuse it follows "
                "from the albedo)",
                static_cast<double>(total[c]), channels[c]);
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
                         "irregularity", "comment"});
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

    const JsonValue pattern = value["pattern"];
    if (pattern.is_text()) {
        fabric.pattern = pattern.text();
        take_draft(fabric, builtin_weave(fabric.pattern, value.path(), pattern.line()));
    } else {
        pattern.expect_object({"wif"});
        fabric.pattern = pattern["wif"].file();
        take_draft(fabric, read_wif(fabric.pattern));
    }
    for (const bool is_warp : {true, false}) {
        const char* key = is_warp ? "warp" : "weft";
        YarnSpec& yarn = is_warp ? fabric.warp : fabric.weft;
        const bool given = value.has(key);
        if (given) parse_yarn(value[key], yarn);
        complete_lengths(yarn, is_warp ? fabric.draft.ends : fabric.draft.picks, given && value[key].has("spacing"),
                         given && value[key].has("width"));
    }
    return fabric;
}

Fabric load_fabric(const std::string& path, const Overrides& overrides)
{
    std::string extension = std::filesystem::path(path).extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (extension != ".wif") return parse_fabric(JsonValue::read(path, overrides));

    // A bare draft is the fabric that says nothing but its pattern.
    const std::string name = std::filesystem::path(path).filename().string();
    const nlohmann::json bare = {{"name", stem(path)},
                                 {"pattern", {{"wif", name}}},
                                 {"use_draft_colours", true},
                                 {"warp", {{"albedo", 0.9}}},
                                 {"weft", {{"albedo", 0.9}}}};
    return parse_fabric(
        JsonValue::parse(bare.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace), path, overrides));
}

YarnTypes yarn_types(const Fabric& fabric)
{
    YarnTypes out;
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

const char* visibility_name(VisibilityKind kind)
{
    for (const auto& row : visibility_names)
        if (row.kind == kind) return row.name;
    return "?";
}

} // namespace selvedge
