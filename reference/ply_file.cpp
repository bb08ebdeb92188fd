// The PLY reader: header, then elements in the order of the header; every read is checked against the end of the file.
#include "reference/ply_file.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>

#include "bake/error.hpp"
#include "bake/image.hpp"

namespace selvedge
{

namespace
{

enum class Format { ascii, little, big };
enum class Type { int8, uint8, int16, uint16, int32, uint32, float32, float64 };

struct Property {
    std::string name;
    Type type = Type::float32;
    bool list = false;
    Type count_type = Type::uint8;
};

struct Element {
    std::string name;
    std::uint64_t count = 0;
    std::vector<Property> properties;
};

std::size_t size_of(Type type)
{
    switch (type) {
    case Type::int8:
    case Type::uint8:
        return 1;
    case Type::int16:
    case Type::uint16:
        return 2;
    case Type::float64:
        return 8;
    default:
        return 4;
    }
}

class Reader
{
  public:
    Reader(const std::string& path, const std::string& bytes) : path_(path), bytes_(bytes) {}

    PlyFile read()
    {
        read_header();
        for (const Element& element : elements_) {
            // Every row takes a byte at least, so a count beyond the file's size is a lie; it is not allocated.
            if (!element.properties.empty() && element.count > bytes_.size() - at_) cut_short(element, 0);
            if (element.name == "vertex")
                read_vertices(element);
            else if (element.name == "face")
                read_faces(element);
            else
                for (std::uint64_t row = 0; row < element.count; ++row)
                    for (const Property& property : element.properties) skip(element, row, property);
        }
        if (!seen_vertices_) throw InputError(path_, 0, "found no vertices, expected an element \"vertex\"");
        for (std::size_t k = 0; k < file_.corners.size(); ++k)
            if (file_.corners[k] >= file_.positions.size()) bad_index(k);
        return std::move(file_);
    }

  private:
    // ---- header ----

    std::vector<std::string> header_line()
    {
        std::size_t end = at_;
        while (end < bytes_.size() && bytes_[end] != '\n' && bytes_[end] != '\r') ++end;
        if (end == bytes_.size())
            throw InputError(path_, line_ + 1, "found the end of the file, expected \"end_header\"");
        std::string text = bytes_.substr(at_, end - at_);
        at_ = end + 1;
        if (bytes_[end] == '\r' && at_ < bytes_.size() && bytes_[at_] == '\n') ++at_;
        ++line_;
        std::vector<std::string> words;
        for (std::size_t from = 0; from < text.size();) {
            const std::size_t start = text.find_first_not_of(" \t", from);
            if (start == std::string::npos) break;
            const std::size_t stop = std::min(text.find_first_of(" \t", start), text.size());
            words.push_back(text.substr(start, stop - start));
            from = stop;
        }
        return words;
    }

    Type type_of(const std::string& word) const
    {
        static const std::pair<const char*, Type> names[] = {
            {"char", Type::int8},      {"int8", Type::int8},       {"uchar", Type::uint8},
            {"uint8", Type::uint8},    {"short", Type::int16},     {"int16", Type::int16},
            {"ushort", Type::uint16},  {"uint16", Type::uint16},   {"int", Type::int32},
            {"int32", Type::int32},    {"uint", Type::uint32},     {"uint32", Type::uint32},
            {"float", Type::float32},  {"float32", Type::float32}, {"double", Type::float64},
            {"float64", Type::float64}};
        for (const auto& [name, type] : names)
            if (word == name) return type;
        throw InputError(path_, line_, "found the type \"%.40s\", expected one of PLY's", word.c_str());
    }

    void read_header()
    {
        if (bytes_.rfind("ply", 0) != 0) throw InputError(path_, 1, "found another kind of file, expected \"ply\"");
        header_line();
        bool has_format = false;
        for (;;) {
            const std::vector<std::string> words = header_line();
            if (words.empty() || words[0] == "comment" || words[0] == "obj_info") continue;
            if (words[0] == "end_header") break;
            if (words[0] == "format" && words.size() >= 2) {
                has_format = true;
                if (words[1] == "ascii")
                    format_ = Format::ascii;
                else if (words[1] == "binary_little_endian")
                    format_ = Format::little;
                else if (words[1] == "binary_big_endian")
                    format_ = Format::big;
                else
                    throw InputError(path_, line_, "found the format \"%.40s\", expected ascii or binary",
                                     words[1].c_str());
            } else if (words[0] == "element" && words.size() >= 3) {
                std::uint64_t count = 0;
                const char* end = words[2].data() + words[2].size();
                const auto parsed = std::from_chars(words[2].data(), end, count);
                if (parsed.ec != std::errc() || parsed.ptr != end || count > std::numeric_limits<std::uint32_t>::max())
                    throw InputError(path_, line_, "found the count \"%.40s\", expected a whole number below 2^32",
                                     words[2].c_str());
                elements_.push_back({words[1], count, {}});
            } else if (words[0] == "property" && words.size() >= 3 && !elements_.empty()) {
                Property property;
                property.list = words[1] == "list";
                if (property.list && words.size() < 5)
                    throw InputError(path_, line_, "found half a list, expected two types and a name");
                if (property.list) property.count_type = type_of(words[2]);
                property.type = type_of(words[property.list ? 3 : 1]);
                property.name = words[property.list ? 4 : 2];
                elements_.back().properties.push_back(property);
            } else {
                throw InputError(path_, line_, "found \"%.40s\", expected format, element, property or end_header",
                                 words[0].c_str());
            }
        }
        if (!has_format) throw InputError(path_, line_, "found no format, expected ascii or binary");
    }

    // ---- values ----

    [[noreturn]] void cut_short(const Element& element, std::uint64_t row) const
    {
        throw InputError(path_, 0, "truncated: found the end of the file in %s %llu, expected %llu of them",
                         element.name.c_str(), static_cast<unsigned long long>(row),
                         static_cast<unsigned long long>(element.count));
    }

    double value(const Element& element, std::uint64_t row, Type type)
    {
        if (format_ == Format::ascii) {
            while (at_ < bytes_.size() &&
                   (bytes_[at_] == ' ' || bytes_[at_] == '\n' || bytes_[at_] == '\r' || bytes_[at_] == '\t'))
                ++at_;
            if (at_ == bytes_.size()) cut_short(element, row);
            const char* from = bytes_.data() + at_ + (bytes_[at_] == '+' ? 1 : 0);
            double number = 0.0;
            const auto parsed = std::from_chars(from, bytes_.data() + bytes_.size(), number);
            if (parsed.ec == std::errc::result_out_of_range) number = INFINITY;
            if (parsed.ec == std::errc::invalid_argument)
                throw InputError(
                    path_, 0, "%s %llu: found \"%s\", expected a number", element.name.c_str(),
                    static_cast<unsigned long long>(row),
                    bytes_.substr(at_, std::min(bytes_.find_first_of(" \t\r\n", at_) - at_, std::size_t(20))).c_str());
            at_ = std::size_t(parsed.ptr - bytes_.data());
            return number;
        }
        const std::size_t size = size_of(type);
        if (size > bytes_.size() - at_) cut_short(element, row);
        unsigned char raw[8];
        std::memcpy(raw, bytes_.data() + at_, size);
        at_ += size;
        if ((format_ == Format::big) != (std::endian::native == std::endian::big)) std::reverse(raw, raw + size);
        const auto as = [&]<class T>(T number) {
            std::memcpy(&number, raw, sizeof(T));
            return double(number);
        };
        switch (type) {
        case Type::int8:
            return as(std::int8_t());
        case Type::uint8:
            return as(std::uint8_t());
        case Type::int16:
            return as(std::int16_t());
        case Type::uint16:
            return as(std::uint16_t());
        case Type::int32:
            return as(std::int32_t());
        case Type::uint32:
            return as(std::uint32_t());
        case Type::float32:
            return as(float());
        default:
            return as(double());
        }
    }

    std::uint64_t list_count(const Element& element, std::uint64_t row, const Property& property)
    {
        const double count = value(element, row, property.count_type);
        if (!(count >= 0.0 && count <= 4294967295.0) || count != std::floor(count))
            throw InputError(path_, 0, "%s %llu: found a list of %g, expected a count", element.name.c_str(),
                             static_cast<unsigned long long>(row), count);
        if (std::uint64_t(count) > bytes_.size() - at_) cut_short(element, row);
        return std::uint64_t(count);
    }

    void skip(const Element& element, std::uint64_t row, const Property& property)
    {
        const std::uint64_t count = property.list ? list_count(element, row, property) : 1;
        for (std::uint64_t k = 0; k < count; ++k) value(element, row, property.type);
    }

    // ---- elements ----

    // Where a vertex property goes: 0-2 position, 3-5 normal, 6-7 UV, -1 nowhere.
    static int slot_of(const Property& property)
    {
        static const std::pair<const char*, int> names[] = {
            {"x", 0}, {"y", 1}, {"z", 2}, {"nx", 3}, {"ny", 4}, {"nz", 5},        {"s", 6},
            {"u", 6}, {"t", 7}, {"v", 7}, {"tx", 6}, {"ty", 7}, {"texture_u", 6}, {"texture_v", 7}};
        if (property.list) return -1;
        for (const auto& [name, slot] : names)
            if (property.name == name) return slot;
        return -1;
    }

    void read_vertices(const Element& element)
    {
        seen_vertices_ = true;
        bool has[8] = {};
        for (const Property& property : element.properties)
            if (const int slot = slot_of(property); slot >= 0) has[slot] = true;
        if (!has[0] || !has[1] || !has[2]) throw InputError(path_, 0, "found vertices without x, y or z");
        const bool normals = has[3] && has[4] && has[5], uv = has[6] && has[7];
        for (std::uint64_t row = 0; row < element.count; ++row) {
            float slots[8] = {};
            for (const Property& property : element.properties) {
                const int slot = slot_of(property);
                if (slot < 0)
                    skip(element, row, property);
                else
                    slots[slot] = float(value(element, row, property.type));
            }
            file_.positions.push_back({slots[0], slots[1], slots[2]});
            if (normals) file_.normals.push_back({slots[3], slots[4], slots[5]});
            if (uv) file_.uv.push_back({slots[6], slots[7]});
        }
    }

    void read_faces(const Element& element)
    {
        bool has_texcoord = false;
        for (const Property& property : element.properties)
            has_texcoord = has_texcoord || (property.list && property.name == "texcoord");
        std::vector<glm::vec2> uv;
        for (std::uint64_t row = 0; row < element.count; ++row) {
            std::uint64_t corners = 0;
            uv.clear();
            for (const Property& property : element.properties) {
                if (property.list && (property.name == "vertex_indices" || property.name == "vertex_index")) {
                    corners = list_count(element, row, property);
                    for (std::uint64_t k = 0; k < corners; ++k) {
                        const double index = value(element, row, property.type);
                        if (!(index >= 0.0 && index <= 4294967294.0) || index != std::floor(index))
                            throw InputError(path_, 0, "face %llu: found vertex index %.10g, expected 0 to %zu",
                                             static_cast<unsigned long long>(row), index, file_.positions.size() - 1);
                        file_.corners.push_back(std::uint32_t(index));
                    }
                } else if (property.list && property.name == "texcoord") {
                    const std::uint64_t count = list_count(element, row, property);
                    for (std::uint64_t k = 0; k < count; ++k) {
                        const float number = float(value(element, row, property.type));
                        if (k % 2 == 0)
                            uv.push_back({number, 0.0f});
                        else
                            uv.back().y = number;
                    }
                } else {
                    skip(element, row, property);
                }
            }
            file_.face_sizes.push_back(std::uint32_t(corners));
            if (has_texcoord) {
                uv.resize(corners, glm::vec2(0.0f));
                file_.corner_uv.insert(file_.corner_uv.end(), uv.begin(), uv.end());
            }
        }
    }

    [[noreturn]] void bad_index(std::size_t corner) const
    {
        std::size_t face = 0, first = 0;
        while (first + file_.face_sizes[face] <= corner) first += file_.face_sizes[face++];
        throw InputError(path_, 0, "face %zu: found vertex index %u, expected 0 to %d", face, file_.corners[corner],
                         int(file_.positions.size()) - 1);
    }

    const std::string& path_;
    const std::string& bytes_;
    std::size_t at_ = 0;
    int line_ = 0;
    Format format_ = Format::ascii;
    std::vector<Element> elements_;
    bool seen_vertices_ = false;
    PlyFile file_;
};

} // namespace

PlyFile read_ply(const std::string& path)
{
    const std::string bytes = read_file(path, std::size_t(2) << 30);
    return Reader(path, bytes).read();
}

} // namespace selvedge
