// reference/model.cpp: names of the model's ingredients, in one table each.
#include "reference/model.hpp"

#include <functional>
#include <stdexcept>

#include "bake/energy.hpp"
#include "bake/error.hpp"

namespace selvedge
{

namespace f32 = cloth::f32;

namespace
{

struct Word {
    const char* name;
    int value;
};
constexpr Word bsdf_words[] = {{"meso", f32::cloth_bsdf_meso}, {"micro", f32::cloth_bsdf_micro}};
constexpr Word weight_words[] = {{"relief", f32::cloth_weight_relief},
                                 {"resample", f32::cloth_weight_resample},
                                 {"mips", f32::cloth_weight_mips},
                                 {"tile", f32::cloth_weight_tile}};
constexpr Word slab_words[] = {{"ply", f32::cloth_slab_ply}, {"macro", f32::cloth_slab_macro}};

struct VisibilityWord {
    const char* name;
    VisibilityKind kind;
    bool used; // false: nothing is shadowed
};
constexpr VisibilityWord visibility_rows[] = {
    {"horizon8", VisibilityKind::horizon8, true}, {"horizon16", VisibilityKind::horizon16, true},
    {"cap", VisibilityKind::cap, true},           {"asg", VisibilityKind::asg, true},
    {"asg-lsq", VisibilityKind::asg_lsq, true},   {"exact", VisibilityKind::exact, true},
    {"none", VisibilityKind::horizon8, false},
};

template <class Words>
const auto& look_up(const Words& words, const std::string& word, const std::function<void(const std::string&)>& fail)
{
    std::string known;
    for (const auto& row : words) {
        if (word == row.name) return row;
        known += (known.empty() ? "" : ", ") + std::string(row.name);
    }
    fail(format_text("found '%s', expected one of %s", word.c_str(), known.c_str()));
    throw std::logic_error("fail() returned");
}

template <class Words> void read_word(const JsonValue& value, const char* key, const Words& words, int& setting)
{
    if (value.has(key))
        setting = look_up(words, value[key].text(), [&](const std::string& text) {
                      value[key].fail("%s", text.c_str());
                  }).value;
}

template <class Words> const char* name_of(const Words& words, int value)
{
    for (const auto& row : words)
        if (row.value == value) return row.name;
    return "?";
}

} // namespace

ModelSpec model_preset(const std::string& mode)
{
    ModelSpec model;
    model.settings = full_model;
    if (mode == "ours") return model;
    model.settings.unscattered = model.settings.interreflection = model.stacked = false;
    if (mode == "jin") {
        model.settings.bsdf = f32::cloth_bsdf_micro;
        model.settings.slab = f32::cloth_slab_macro;
        model.settings.visibility = f32::cloth_visibility_none;
        return model;
    }
    model.settings.weight = f32::cloth_weight_mips;
    model.settings.visibility = f32::cloth_visibility_asg;
    model.visibility = VisibilityKind::asg;
    return model;
}

ModelSpec parse_model(const JsonValue& value)
{
    value.expect_object(
        {"mode", "bsdf", "weight", "visibility", "slab", "unscattered", "stacked", "interreflection", "twist_noise"});
    ModelSpec model = model_preset(value.has("mode") ? value["mode"].choice({"ours", "paper", "jin"}) : "ours");
    f32::ClothSettings& settings = model.settings;
    read_word(value, "bsdf", bsdf_words, settings.bsdf);
    read_word(value, "weight", weight_words, settings.weight);
    read_word(value, "slab", slab_words, settings.slab);
    if (value.has("visibility")) {
        const VisibilityWord& row = look_up(visibility_rows, value["visibility"].text(), [&](const std::string& text) {
            value["visibility"].fail("%s", text.c_str());
        });
        settings.visibility = row.used ? visibility_lookup(row.kind) : f32::cloth_visibility_none;
        model.visibility = row.kind;
    }
    settings.unscattered = value.boolean("unscattered", settings.unscattered);
    model.stacked = value.boolean("stacked", model.stacked);
    settings.interreflection = value.boolean("interreflection", settings.interreflection);
    settings.twist_noise = value.boolean("twist_noise", settings.twist_noise);
    return model;
}

nlohmann::json model_json(const ModelSpec& model)
{
    const f32::ClothSettings& settings = model.settings;
    const bool used = settings.visibility != f32::cloth_visibility_none;
    std::string visibility;
    for (const VisibilityWord& row : visibility_rows)
        if (row.used == used && (row.kind == model.visibility || !used)) visibility = row.name;
    return {{"bsdf", name_of(bsdf_words, settings.bsdf)},
            {"weight", name_of(weight_words, settings.weight)},
            {"visibility", visibility},
            {"slab", name_of(slab_words, settings.slab)},
            {"unscattered", settings.unscattered},
            {"stacked", model.stacked},
            {"interreflection", settings.interreflection},
            {"twist_noise", settings.twist_noise}};
}

void ModelOptions::prepend_to(Overrides& overrides) const
{
    const auto refuse = [](const char* option) {
        return [option](const std::string& text) { throw UsageError("%s: %s", option, text.c_str()); };
    };
    constexpr Word mode_words[] = {{"ours", 0}, {"paper", 1}, {"jin", 2}};
    Overrides said;
    if (!mode.empty()) said.push_back("model.mode=" + std::string(look_up(mode_words, mode, refuse("--mode")).name));
    if (!bsdf.empty()) said.push_back("model.bsdf=" + std::string(look_up(bsdf_words, bsdf, refuse("--bsdf")).name));
    if (!visibility.empty())
        said.push_back("model.visibility=" +
                       std::string(look_up(visibility_rows, visibility, refuse("--visibility")).name));
    overrides.insert(overrides.begin(), said.begin(), said.end());
}

} // namespace selvedge
