// bake/json.cpp: JSON with line numbers: a SAX handler that remembers the line of every value.
#include "json.hpp"

#include <algorithm>
#include <cmath>
#include <cstdarg>
#include <filesystem>
#include <iterator>

#include "error.hpp"
#include "image.hpp"

namespace selvedge
{

namespace
{

using nlohmann::json;

constexpr std::size_t depth_limit = 64;
constexpr std::size_t file_limit = std::size_t(64) << 20;

struct Position {
    int line = 1;
    char last = 0;
};

// Feeds the parser and counts the lines that it has consumed.
class CountingIterator
{
  public:
    using iterator_category = std::input_iterator_tag;
    using value_type = char;
    using difference_type = std::ptrdiff_t;
    using pointer = const char*;
    using reference = const char&;

    CountingIterator(const char* at, Position* position) : at_(at), position_(position) {}
    const char& operator*() const { return *at_; }
    CountingIterator& operator++()
    {
        position_->last = *at_;
        position_->line += *at_ == '\n' ? 1 : 0;
        ++at_;
        return *this;
    }
    CountingIterator operator++(int)
    {
        CountingIterator before = *this;
        ++*this;
        return before;
    }
    bool operator==(const CountingIterator& other) const { return at_ == other.at_; }
    bool operator!=(const CountingIterator& other) const { return at_ != other.at_; }

  private:
    const char* at_;
    Position* position_;
};

std::string escaped(const std::string& key) // RFC 6901
{
    std::string out;
    for (const char c : key) out += c == '~' ? "~0" : c == '/' ? "~1" : std::string(1, c);
    return out;
}

class LineHandler : public nlohmann::json_sax<json>
{
  public:
    LineHandler(JsonDocument& document, const Position& position) : document_(document), position_(position) {}

    bool null() override { return put(nullptr, false); }
    bool boolean(bool value) override { return put(value, false); }
    bool number_integer(std::int64_t value) override { return put(value, true); }
    bool number_unsigned(std::uint64_t value) override { return put(value, true); }
    bool number_float(double value, const std::string&) override { return put(value, true); }
    bool string(std::string& value) override { return put(value, false); }
    bool binary(json::binary_t&) override { return false; }
    bool start_object(std::size_t) override { return open(json::object()); }
    bool start_array(std::size_t) override { return open(json::array()); }
    bool end_object() override { return close(); }
    bool end_array() override { return close(); }

    bool key(std::string& value) override
    {
        key_ = value;
        key_line_ = position_.line;
        if (stack_.back().node->contains(value))
            throw InputError(document_.path, key_line_, "%s: occurs twice in one object, expected once", value.c_str());
        return true;
    }

    bool parse_error(std::size_t, const std::string& token, const json::exception& error) override
    {
        std::string text = error.what();
        if (const auto at = text.find("parse error"); at != std::string::npos)
            if (const auto colon = text.find(": ", at); colon != std::string::npos) text = text.substr(colon + 2);
        const int line = position_.line - (position_.last == '\n' && token.find('\n') == std::string::npos ? 1 : 0);
        throw InputError(document_.path, std::max(line, 1), "broken JSON: %s", text.c_str());
    }

  private:
    struct Level {
        json* node;
        std::string pointer;
    };

    // The lexer reads one character past a number: a line break there is not the value's.
    json* add(json value, bool number, std::string& pointer)
    {
        int line = position_.line - (number && position_.last == '\n' ? 1 : 0);
        json* place = &document_.root;
        if (!stack_.empty()) {
            Level& level = stack_.back();
            if (level.node->is_array()) {
                (pointer = level.pointer + '/') += std::to_string(level.node->size());
                level.node->push_back(std::move(value));
                place = &level.node->back();
            } else {
                (pointer = level.pointer + '/') += escaped(key_);
                line = key_line_;
                place = &((*level.node)[key_] = std::move(value));
            }
        } else {
            *place = std::move(value);
        }
        document_.lines[pointer] = line;
        return place;
    }

    bool put(json value, bool number)
    {
        std::string pointer;
        add(std::move(value), number, pointer);
        return true;
    }

    bool open(json value)
    {
        if (stack_.size() >= depth_limit)
            throw InputError(document_.path, position_.line, "nested deeper than %zu levels, expected less",
                             depth_limit);
        std::string pointer;
        json* place = add(std::move(value), false, pointer);
        stack_.push_back({place, pointer});
        return true;
    }

    bool close()
    {
        stack_.pop_back();
        return true;
    }

    JsonDocument& document_;
    const Position& position_;
    std::vector<Level> stack_;
    std::string key_;
    int key_line_ = 0;
};

const char* kind(const json& node)
{
    switch (node.type()) {
    case json::value_t::object:
        return "an object";
    case json::value_t::array:
        return "an array";
    case json::value_t::string:
        return "text";
    case json::value_t::boolean:
        return "true or false";
    case json::value_t::null:
        return "null";
    default:
        return "a number";
    }
}

std::string shown(const json& node)
{
    if (node.is_structured()) return kind(node);
    std::string text = node.dump(-1, ' ', false, json::error_handler_t::replace);
    return text.size() <= 60 ? text : text.substr(0, 57) + "...";
}

// Moves the lines of everything under `pointer` to 0: an override has replaced it.
void forget_lines(JsonDocument& document, const std::string& pointer)
{
    for (auto& [place, line] : document.lines)
        if (place == pointer || place.rfind(pointer + "/", 0) == 0) line = 0;
    document.lines[pointer] = 0;
}

void apply_override(JsonDocument& document, const std::string& text)
{
    const auto equals = text.find('=');
    if (equals == std::string::npos || equals == 0) throw UsageError("-D %s: expected path.to.key=value", text.c_str());
    json value = json::parse(text.substr(equals + 1), nullptr, false);
    if (value.is_discarded()) value = text.substr(equals + 1);

    json* node = &document.root;
    std::string pointer, path = text.substr(0, equals) + ".";
    std::size_t depth = 0;
    for (std::size_t from = 0, dot = 0; (dot = path.find('.', from)) != std::string::npos; from = dot + 1) {
        const std::string key = path.substr(from, dot - from);
        if (key.empty() || ++depth > depth_limit) throw UsageError("-D %s: expected path.to.key=value", text.c_str());
        if (node->is_array()) {
            std::size_t index = node->size();
            if (key.size() < 9 && key.find_first_not_of("0123456789") == std::string::npos) index = std::stoul(key);
            if (index >= node->size())
                throw UsageError("-D %s: %s is not one of the %zu elements", text.c_str(), key.c_str(), node->size());
            node = &(*node)[index];
        } else {
            if (node->is_null()) *node = json::object();
            if (!node->is_object())
                throw UsageError("-D %s: %s lies inside %s, expected an object", text.c_str(), key.c_str(),
                                 kind(*node));
            node = &(*node)[key];
        }
        (pointer += '/') += escaped(key);
        if (!document.lines.count(pointer)) document.lines[pointer] = 0;
    }
    *node = std::move(value);
    forget_lines(document, pointer);
}

// Levenshtein distance: finds the key that a person meant.
std::size_t distance(const std::string& a, const std::string& b)
{
    std::vector<std::size_t> row(b.size() + 1);
    for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
    for (std::size_t i = 1; i <= a.size(); ++i) {
        std::size_t diagonal = row[0];
        row[0] = i;
        for (std::size_t j = 1; j <= b.size(); ++j) {
            const std::size_t above = row[j];
            row[j] = std::min({above + 1, row[j - 1] + 1, diagonal + (a[i - 1] == b[j - 1] ? 0u : 1u)});
            diagonal = above;
        }
    }
    return row[b.size()];
}

} // namespace

JsonValue JsonValue::parse(const std::string& text, const std::string& name, const Overrides& overrides)
{
    auto document = std::make_shared<JsonDocument>();
    document->path = name;
    Position position;
    LineHandler handler(*document, position);
    const std::size_t bom = text.rfind("\xEF\xBB\xBF", 0) == 0 ? 3 : 0;
    const char* end = text.data() + text.size();
    if (!json::sax_parse(CountingIterator(text.data() + bom, &position), CountingIterator(end, &position), &handler,
                         json::input_format_t::json, true, true))
        throw InputError(name, position.line, "broken JSON");
    for (const std::string& override : overrides) apply_override(*document, override);
    JsonValue value;
    value.node = &document->root;
    value.document = std::move(document);
    return value;
}

JsonValue JsonValue::read(const std::string& path, const Overrides& overrides)
{
    return parse(read_file(path, file_limit), path, overrides);
}

bool JsonValue::has(const char* key) const
{
    return node->is_object() && node->contains(key) && !(*node)[key].is_null();
}

JsonValue JsonValue::operator[](const char* key) const
{
    if (!node->is_object()) fail("found %s, expected an object", shown(*node).c_str());
    if (!has(key)) fail("\"%s\" is missing, expected it here", key);
    JsonValue value = *this;
    value.node = &(*node)[key];
    (value.pointer += '/') += escaped(key);
    return value;
}

JsonValue JsonValue::operator[](std::size_t index) const
{
    if (!node->is_array()) fail("found %s, expected an array", shown(*node).c_str());
    if (index >= node->size()) fail("found %zu elements, expected at least %zu", node->size(), index + 1);
    JsonValue value = *this;
    value.node = &(*node)[index];
    (value.pointer += '/') += std::to_string(index);
    return value;
}

std::vector<JsonValue> JsonValue::elements() const
{
    if (!node->is_array()) return {*this};
    std::vector<JsonValue> values;
    for (std::size_t i = 0; i < node->size(); ++i) values.push_back((*this)[i]);
    return values;
}

double JsonValue::number(double low, double high) const
{
    if (!node->is_number()) fail("found %s, expected a number from %g to %g", shown(*node).c_str(), low, high);
    const double value = node->get<double>();
    if (!(value >= low && value <= high))
        fail("found %s, expected a number from %g to %g", shown(*node).c_str(), low, high);
    return value;
}

int JsonValue::integer(int low, int high) const
{
    const double value = node->is_number() ? node->get<double>() : std::nan("");
    if (!(value >= low && value <= high) || value != std::floor(value))
        fail("found %s, expected a whole number from %d to %d", shown(*node).c_str(), low, high);
    return static_cast<int>(value);
}

bool JsonValue::boolean() const
{
    if (!node->is_boolean()) fail("found %s, expected true or false", shown(*node).c_str());
    return node->get<bool>();
}

std::string JsonValue::text() const
{
    if (!node->is_string()) fail("found %s, expected text", shown(*node).c_str());
    return node->get<std::string>();
}

std::string JsonValue::choice(const std::vector<const char*>& words) const
{
    std::string list;
    for (const char* word : words) {
        if (node->is_string() && node->get<std::string>() == word) return word;
        list += list.empty() ? "" : ", ";
        list += word;
    }
    fail("found %s, expected one of %s", shown(*node).c_str(), list.c_str());
}

glm::vec3 JsonValue::vector3(double low, double high) const
{
    if (!node->is_array() || node->size() != 3) fail("found %s, expected 3 numbers in brackets", shown(*node).c_str());
    glm::vec3 value;
    for (int i = 0; i < 3; ++i) value[i] = static_cast<float>((*this)[static_cast<std::size_t>(i)].number(low, high));
    return value;
}

glm::vec2 JsonValue::vector2(double low, double high) const
{
    if (!node->is_array() || node->size() != 2) fail("found %s, expected 2 numbers in brackets", shown(*node).c_str());
    return {static_cast<float>((*this)[std::size_t(0)].number(low, high)),
            static_cast<float>((*this)[std::size_t(1)].number(low, high))};
}

glm::vec3 JsonValue::number_or_vector3(double low, double high) const
{
    return node->is_array() ? vector3(low, high) : glm::vec3(static_cast<float>(number(low, high)));
}

glm::vec2 JsonValue::number_or_vector2(double low, double high) const
{
    return node->is_array() ? vector2(low, high) : glm::vec2(static_cast<float>(number(low, high)));
}

std::string JsonValue::file() const
{
    return path_beside(document->path, text());
}

double JsonValue::number(const char* key, double otherwise, double low, double high) const
{
    return has(key) ? (*this)[key].number(low, high) : otherwise;
}

int JsonValue::integer(const char* key, int otherwise, int low, int high) const
{
    return has(key) ? (*this)[key].integer(low, high) : otherwise;
}

bool JsonValue::boolean(const char* key, bool otherwise) const
{
    return has(key) ? (*this)[key].boolean() : otherwise;
}

std::string JsonValue::text(const char* key, const std::string& otherwise) const
{
    return has(key) ? (*this)[key].text() : otherwise;
}

glm::vec3 JsonValue::vector3(const char* key, glm::vec3 otherwise, double low, double high) const
{
    return has(key) ? (*this)[key].vector3(low, high) : otherwise;
}

void JsonValue::expect_object(std::initializer_list<const char*> keys) const
{
    if (!node->is_object()) fail("found %s, expected an object", shown(*node).c_str());
    for (const auto& [key, value] : node->items()) {
        if (std::find(keys.begin(), keys.end(), key) != keys.end()) continue;
        const char* nearest = nullptr;
        std::size_t best = 1 + key.size() / 2;
        for (const char* known : keys)
            if (const std::size_t d = distance(key.substr(0, 100), known); d < best) {
                best = d;
                nearest = known;
            }
        const JsonValue culprit = (*node)[key].is_null() ? *this : (*this)[key.c_str()];
        if (nearest) culprit.fail("unknown key \"%s\", expected \"%s\"", key.c_str(), nearest);
        std::string list;
        for (const char* known : keys) list += (list.empty() ? "" : ", ") + std::string(known);
        culprit.fail("unknown key \"%s\", expected one of %s", key.c_str(), list.c_str());
    }
}

int JsonValue::line() const
{
    const auto found = document->lines.find(pointer);
    return found == document->lines.end() ? 0 : found->second;
}

std::string JsonValue::key() const
{
    std::string out;
    for (std::size_t i = 1; i < pointer.size(); ++i) out += pointer[i] == '/' ? '.' : pointer[i];
    return out;
}

void JsonValue::fail(const char* format, ...) const
{
    std::va_list arguments;
    va_start(arguments, format);
    const std::string text = format_text_list(format, arguments);
    va_end(arguments);
    const std::string where = key();
    throw InputError(document->path, line(), "%s%s%s%s", line() == 0 ? "-D " : "", where.c_str(),
                     where.empty() ? "" : ": ", text.c_str());
}

std::string path_beside(const std::string& from, const std::string& name)
{
    const std::filesystem::path path(name);
    return path.is_absolute() ? name : (std::filesystem::path(from).parent_path() / path).string();
}

} // namespace selvedge
