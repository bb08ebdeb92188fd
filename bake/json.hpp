// bake/json.hpp: JSON files that people write, with file, line and key in every complaint. Fabrics and scenes use it.
#pragma once

#include <initializer_list>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <glm/glm.hpp>
#include <nlohmann/json.hpp>

namespace selvedge
{

// "path.to.key=value": value is JSON, or a bare word taken as text. Numbers in the path index arrays:
// "objects.0.scale=2".
using Overrides = std::vector<std::string>;

struct JsonDocument {
    std::string path; // as the person wrote it
    nlohmann::json root;
    std::map<std::string, int> lines; // JSON pointer ("/warp/spacing") -> line in the file
};

// One value in a document. Readers name the key and give the default; what is not there takes the default, what has
// the wrong type or lies outside the range is an InputError `file:line: key: found X, expected Y`.
class JsonValue
{
  public:
    // The root of a file. `//` comments are allowed. A missing file, broken JSON, a key that occurs twice in one object
    // and an override that fits nowhere are errors.
    static JsonValue read(const std::string& path, const Overrides& overrides = {});
    static JsonValue parse(const std::string& text, const std::string& name, const Overrides& overrides = {});

    bool has(const char* key) const;               // false for null, too
    JsonValue operator[](const char* key) const;   // must exist
    JsonValue operator[](std::size_t index) const; // must exist
    std::vector<JsonValue> elements() const;       // of an array; of anything else, the value itself

    double number(double low, double high) const;
    int integer(int low, int high) const;
    bool boolean() const;
    std::string text() const;
    std::string choice(const std::vector<const char*>& words) const;
    glm::vec3 vector3(double low, double high) const; // [x, y, z]
    glm::vec2 vector2(double low, double high) const; // [x, y]
    glm::vec3 number_or_vector3(double low, double high) const;
    glm::vec2 number_or_vector2(double low, double high) const;
    std::string file() const; // text as a path, relative to the folder of the document

    double number(const char* key, double otherwise, double low, double high) const;
    int integer(const char* key, int otherwise, int low, int high) const;
    bool boolean(const char* key, bool otherwise) const;
    std::string text(const char* key, const std::string& otherwise) const;
    glm::vec3 vector3(const char* key, glm::vec3 otherwise, double low, double high) const;

    // An object with exactly some of these keys; an unknown key is an error that names the nearest known one.
    void expect_object(std::initializer_list<const char*> keys) const;

    bool is_object() const { return node->is_object(); }
    bool is_array() const { return node->is_array(); }
    bool is_text() const { return node->is_string(); }
    bool is_number() const { return node->is_number(); }

    int line() const;                                          // 0 where an override made it
    const std::string& path() const { return document->path; } // of the file
    std::string key() const;                                   // "objects.0.scale"; for messages
    const nlohmann::json& raw() const { return *node; }

    // throws InputError with this value's file, line and key before the text
    [[noreturn, gnu::format(printf, 2, 3)]] void fail(const char* format, ...) const;

  private:
    std::shared_ptr<const JsonDocument> document;
    const nlohmann::json* node = nullptr;
    std::string pointer;
};

// `name` relative to the folder that holds `from`; absolute names as they are.
std::string path_beside(const std::string& from, const std::string& name);

} // namespace selvedge
