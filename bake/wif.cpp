// bake/wif.cpp: reader and writer of WIF drafts.
#include "wif.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <map>

#include "error.hpp"
#include "image.hpp"

namespace selvedge
{

namespace
{

constexpr std::size_t file_limit = std::size_t(48) << 20; // bytes: room for the largest draft as format_wif writes it
constexpr int entry_limit = 1 << 19; // sections and key=value lines; the largest draft has a quarter
constexpr int shaft_limit = 10000;
constexpr int colour_limit = 1 << 16;
constexpr int surplus_threads = 100; // declared and not used: so many are not part of the cloth

struct Entry {
    std::string value;
    int line = 0;
};

struct Section {
    int line = 0;
    bool again = false;                    // it occurs twice, and that has been said
    std::map<std::string, Entry> words;    // "threads" -> ...
    std::map<std::int64_t, Entry> numbers; // 1 -> ...
};

std::string trimmed(const std::string& text)
{
    const auto from = text.find_first_not_of(" \t");
    return from == std::string::npos ? std::string() : text.substr(from, text.find_last_not_of(" \t") - from + 1);
}

std::string lower(std::string text)
{
    for (char& c : text)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return text;
}

template <class Number> bool read_number(const std::string& text, Number& value)
{
    const char* from = text.data() + (!text.empty() && text[0] == '+' ? 1 : 0);
    const auto [end, error] = std::from_chars(from, text.data() + text.size(), value);
    return error == std::errc() && end == text.data() + text.size();
}

std::vector<std::string> split(const std::string& text)
{
    std::vector<std::string> parts;
    for (std::size_t from = 0; from <= text.size();) {
        const std::size_t comma = std::min(text.find(',', from), text.size());
        parts.push_back(trimmed(text.substr(from, comma - from)));
        from = comma + 1;
    }
    return parts;
}

float linear_from_srgb(float v)
{
    return v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f);
}

float srgb_from_linear(float v)
{
    return v <= 0.0031308f ? v * 12.92f : 1.055f * std::pow(v, 1 / 2.4f) - 0.055f;
}

// A colour value as a whole number from 0 to `top`.
int step_of(float linear, int top)
{
    return static_cast<int>(std::lround(srgb_from_linear(linear) * static_cast<float>(top)));
}

// The smallest usual range whose steps are these colours.
int range_for(const std::vector<glm::vec3>& colours)
{
    for (const int top : {255, 999}) {
        bool exact = true;
        for (const glm::vec3 colour : colours)
            for (int c = 0; c < 3; ++c) {
                const float value = static_cast<float>(step_of(colour[c], top)) / static_cast<float>(top);
                exact = exact && std::abs(linear_from_srgb(value) - colour[c]) <= 1e-6f;
            }
        if (exact) return top;
    }
    return 65535;
}

class WifReader
{
  public:
    WifReader(const std::string& text, const std::string& name) : name_(name) { split_sections(decoded(text)); }

    Draft read()
    {
        if (sections_.empty()) throw InputError(name_, 0, "no [SECTION] in the file, expected a WIF draft");
        if (!sections_.count("wif")) warn("no [WIF] section");
        const Entry* version = word("wif", "version");
        if (version && version->value.rfind("1.", 0) != 0)
            warn("Version=%s: read as 1.1", printable(version->value).c_str());
        if (const Entry* title = word("text", "title")) draft_.title = title->value;
        refuse_truncated();
        read_header_numbers();

        const Section& threading = required("threading", "which shafts carry each end");
        const bool by_liftplan = choose_liftplan();
        const Section& picks = by_liftplan ? *section("liftplan") : required("treadling", "or [LIFTPLAN]");
        if (!by_liftplan) required("tieup", "or [LIFTPLAN]");

        draft_.ends.resize(thread_count("warp", "threading", threading));
        draft_.picks.resize(thread_count("weft", by_liftplan ? "liftplan" : "treadling", picks));
        if (draft_.ends.size() * draft_.picks.size() > std::size_t(crossing_limit))
            throw InputError(name_, picks.line, "%zu ends x %zu picks, expected at most %d crossings",
                             draft_.ends.size(), draft_.picks.size(), crossing_limit);
        interlace(threading, picks, by_liftplan);
        read_colour_table();
        read_threads("warp", draft_.ends);
        read_threads("weft", draft_.picks);
        flush_counts();
        return std::move(draft_);
    }

  private:
    [[gnu::format(printf, 2, 3)]] void warn(const char* format, ...)
    {
        std::va_list arguments;
        va_start(arguments, format);
        draft_.warnings.push_back(format_text_list(format, arguments));
        va_end(arguments);
    }

    // To bytes with '\n' line ends: UTF-16 by its mark, or by a NUL in every other byte of the beginning; other NUL
    // bytes as blanks. Other encodings need no care: only titles hold letters outside ASCII.
    std::string decoded(const std::string& text)
    {
        std::string bytes;
        const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
        const auto all_zero = [&](std::size_t first) {
            for (std::size_t i = first; i < 16; i += 2)
                if (byte(i) != 0 || byte(i ^ 1) == 0) return false;
            return true;
        };
        const bool mark = text.size() >= 2 && byte(0) + byte(1) == 0xFF + 0xFE && byte(0) >= 0xFE;
        const bool little = mark ? byte(0) == 0xFF : text.size() >= 16 && all_zero(1);
        const bool big = mark ? byte(0) == 0xFE : text.size() >= 16 && all_zero(0);
        if (little || big) {
            for (std::size_t i = mark ? 2 : 0; i + 1 < text.size(); i += 2) {
                const unsigned low = byte(i + (little ? 0 : 1)), high = byte(i + (little ? 1 : 0));
                bytes += high == 0 && low < 128 ? static_cast<char>(low) : '?';
            }
            warn(mark ? "UTF-16 text" : "UTF-16 text without its mark");
        } else {
            bytes = text.rfind("\xEF\xBB\xBF", 0) == 0 ? text.substr(3) : text;
        }
        std::string out;
        std::size_t zeros = 0;
        for (std::size_t i = 0; i < bytes.size(); ++i) {
            const char c = bytes[i];
            if (c == '\r')
                out += i + 1 < bytes.size() && bytes[i + 1] == '\n' ? "" : "\n";
            else if (c == '\0')
                ++zeros, out += ' ';
            else
                out += c;
        }
        if (zeros > 0) warn("%zu NUL bytes, read as blanks", zeros);
        return out;
    }

    void split_sections(const std::string& text)
    {
        Section* current = nullptr;
        bool is_private = false;
        int line = 0, loose = 0, first_loose = 0, entries = 0;
        const auto count_entry = [&] {
            if (++entries > entry_limit)
                throw InputError(name_, line, "more than %d sections and key=value lines, expected fewer", entry_limit);
        };
        for (std::size_t from = 0; from < text.size();) {
            const std::size_t end = std::min(text.find('\n', from), text.size());
            const std::string content = trimmed(text.substr(from, end - from));
            ++line;
            cut_ = end == text.size() && !content.empty();
            from = end + 1;
            if (content.empty() || content[0] == ';') continue;
            if (content[0] == '[') {
                const auto close = content.find(']');
                if (close == std::string::npos) {
                    if (cut_)
                        throw InputError(name_, line,
                                         "file ends inside the section name \"%s\", expected the rest: truncated",
                                         printable(content).c_str());
                    ++loose, first_loose = first_loose ? first_loose : line;
                    continue;
                }
                const std::string section_name = lower(trimmed(content.substr(1, close - 1)));
                count_entry();
                const bool again = sections_.count(section_name) > 0;
                current = &sections_[section_name];
                last_section_ = section_name;
                is_private = section_name.rfind("private", 0) == 0 || section_name == "notes" || section_name == "text";
                if (again && !is_private && !current->again) {
                    current->again = true;
                    warn("line %d: section [%s] again (first on line %d); later entries win", line,
                         printable(section_name).c_str(), current->line);
                } else if (!again) {
                    current->line = line;
                }
                continue;
            }
            const auto equals = content.find('=');
            if (equals == std::string::npos || !current) {
                if (!is_private) ++loose, first_loose = first_loose ? first_loose : line;
                continue;
            }
            const std::string key = lower(trimmed(content.substr(0, equals)));
            // Only a blank before ';' starts a comment: titles may hold one.
            std::string value = trimmed(content.substr(equals + 1));
            if (const auto comment = value.find(" ;"); comment != std::string::npos && !is_private)
                value = trimmed(value.substr(0, comment));
            count_entry();
            std::int64_t number = 0;
            if (read_number(key, number))
                current->numbers[number] = {value, line};
            else
                current->words[key] = {value, line};
        }
        last_line_ = line;
        if (loose > 0)
            warn("%d lines that are neither [SECTION] nor key=value, the first on line %d: ignored", loose,
                 first_loose);
    }

    const Section* section(const char* key) const
    {
        const auto found = sections_.find(key);
        return found == sections_.end() ? nullptr : &found->second;
    }

    const Section& required(const char* key, const char* what) const
    {
        std::string upper = key;
        for (char& c : upper) c = static_cast<char>(c - 'a' + 'A');
        const Section* found = section(key);
        if (!found)
            throw InputError(name_, last_line_, "file ends without a [%s] section, expected it: %s", upper.c_str(),
                             what);
        if (found->numbers.empty())
            throw InputError(name_, found->line, "[%s] has no entries, expected lines such as 1=2", upper.c_str());
        return *found;
    }

    const Entry* word(const char* in, const char* key) const
    {
        const Section* s = section(in);
        const auto found = s ? s->words.find(key) : std::map<std::string, Entry>::const_iterator();
        return s && found != s->words.end() ? &found->second : nullptr;
    }

    // true, false; -1 where the word says neither
    static int flag(const std::string& text)
    {
        const std::string value = lower(text);
        for (const char* yes : {"true", "yes", "on", "1"})
            if (value == yes) return 1;
        for (const char* no : {"false", "no", "off", "0"})
            if (value == no) return 0;
        return -1;
    }

    int promised(const char* key) const
    {
        const Entry* entry = word("contents", key);
        return entry ? flag(entry->value) : -1;
    }

    // A file that lacks what its own [CONTENTS] announces and stops in the middle of a line, or before the last thread,
    // has been cut.
    void refuse_truncated()
    {
        std::string missing;
        for (const char* key :
             {"weaving", "warp", "weft", "threading", "tieup", "treadling", "liftplan", "color table", "color palette",
              "warp colors", "weft colors", "warp spacing", "weft spacing", "warp thickness", "weft thickness"})
            if (promised(key) == 1 && !section(key))
                missing += (missing.empty() ? "[" : ", [") + std::string(key) + "]";
        if (missing.empty()) return;
        const Section& last = sections_[last_section_];
        const Entry* declared = word(last_section_ == "threading" ? "warp" : "weft", "threads");
        std::int64_t count = 0;
        const bool threads =
            last_section_ == "threading" || last_section_ == "treadling" || last_section_ == "liftplan";
        const bool stops_short = threads && declared && read_number(declared->value, count) && !last.numbers.empty() &&
                                 last.numbers.rbegin()->first < count;
        if (cut_ || stops_short)
            throw InputError(name_, last_line_,
                             "file ends inside [%s], without %s that [CONTENTS] announces: truncated",
                             printable(last_section_).c_str(), missing.c_str());
        warn("[CONTENTS] announces %s: not in the file", missing.c_str());
    }

    void read_header_numbers()
    {
        for (const char* key : {"shafts", "treadles"}) {
            const Entry* entry = word("weaving", key);
            std::int64_t value = 0;
            if (entry && (!read_number(entry->value, value) || value < 0))
                throw InputError(name_, entry->line, "%s=%s, expected a whole number", key,
                                 printable(entry->value).c_str());
            if (entry && std::string(key) == "shafts") declared_shafts_ = value;
        }
        const Entry* shed = word("weaving", "rising shed");
        const int rising = shed ? flag(shed->value) : -1;
        if (rising < 0) warn(shed ? "Rising Shed is neither yes nor no: taken as yes" : "no Rising Shed: taken as yes");
        rising_ = rising != 0;
    }

    bool choose_liftplan()
    {
        const Section* lift = section("liftplan");
        const Section* tread = section("treadling");
        const Section* tie = section("tieup");
        const bool has_lift = lift && !lift->numbers.empty();
        const bool has_tieup = tread && tie && !tread->numbers.empty() && !tie->numbers.empty();
        if (has_lift && has_tieup) {
            const bool lift_wins = promised("liftplan") == 1 && promised("treadling") != 1;
            warn("both [LIFTPLAN] and [TIEUP] with [TREADLING]: took %s", lift_wins ? "[LIFTPLAN]" : "[TIEUP]");
            return lift_wins;
        }
        return has_lift;
    }

    std::size_t thread_count(const char* system, const char* entries_name, const Section& entries)
    {
        std::int64_t listed = entries.numbers.rbegin()->first; // the sections required() gives are not empty
        const Entry* declared = word(system, "threads");
        std::int64_t count = 0;
        if (declared && (!read_number(declared->value, count) || count < 0))
            throw InputError(name_, declared->line, "[%s] Threads=%s, expected a whole number", system,
                             printable(declared->value).c_str());
        const int line = declared ? declared->line : entries.numbers.rbegin()->second.line;
        if (count == 0) {
            count = listed;
            warn("[%s] gives no number of threads: took %lld from [%s]", system, static_cast<long long>(count),
                 entries_name);
        } else if (listed > 0 && listed <= count / 2 && count - listed >= surplus_threads && count <= thread_limit) {
            // Some programs declare their maximum (WeavePoint: 1200). A few threads on no shaft may be meant.
            warn("[%s] declares %lld threads and [%s] ends at %lld: the rest is left out", system,
                 static_cast<long long>(count), entries_name, static_cast<long long>(listed));
            count = listed;
        } else if (listed > count) {
            warn("[%s] lists thread %lld of %lld: the rest is ignored", entries_name, static_cast<long long>(listed),
                 static_cast<long long>(count));
        }
        if (count < 1 || count > thread_limit)
            throw InputError(name_, line, "%lld threads in [%s], expected 1 to %d", static_cast<long long>(count),
                             system, thread_limit);
        return static_cast<std::size_t>(count);
    }

    // "1,3,4" -> numbers from 1; 0 and nothing mean "none".
    std::vector<int> number_list(const Entry& entry, const char* what)
    {
        std::vector<int> list;
        for (const std::string& part : split(entry.value)) {
            if (part.empty()) continue;
            std::int64_t value = 0;
            if (!read_number(part, value) || value < 0 || value > shaft_limit)
                throw InputError(name_, entry.line, "%s \"%s\", expected whole numbers from 0 to %d", what,
                                 printable(part).c_str(), shaft_limit);
            if (value > 0) list.push_back(static_cast<int>(value));
        }
        std::sort(list.begin(), list.end());
        list.erase(std::unique(list.begin(), list.end()), list.end());
        return list;
    }

    // Lists by thread, 0-based; threads without an entry have an empty one. `count` 0: as many as there are.
    std::vector<std::vector<int>> lists(const Section& from, const char* what, std::size_t count)
    {
        std::size_t size = count;
        if (count == 0)
            for (const auto& [number, entry] : from.numbers)
                if (number >= 1 && number <= shaft_limit) size = static_cast<std::size_t>(number);
        std::vector<std::vector<int>> out(size);
        for (const auto& [number, entry] : from.numbers)
            if (number >= 1 && number <= static_cast<std::int64_t>(size))
                out[static_cast<std::size_t>(number - 1)] = number_list(entry, what);
        return out;
    }

    // Shafts as bits: a pick's are the union of its treadles', and a list may be as long as the file.
    using ShaftSet = std::vector<std::uint64_t>;

    static ShaftSet shaft_set(const std::vector<int>& shafts, int highest)
    {
        ShaftSet set(static_cast<std::size_t>(highest) / 64 + 1);
        for (const int shaft : shafts)
            if (shaft <= highest) set[static_cast<std::size_t>(shaft) / 64] |= std::uint64_t(1) << (shaft % 64);
        return set;
    }

    // Which shafts move on each pick, handed to `each`(pick, set).
    template <class Each> void shafts_of_picks(const Section& picks, bool by_liftplan, int highest, Each&& each)
    {
        const auto named = lists(picks, by_liftplan ? "shaft" : "treadle", draft_.picks.size());
        std::vector<ShaftSet> tied;
        if (!by_liftplan)
            for (const auto& shafts : lists(*section("tieup"), "shaft", 0)) tied.push_back(shaft_set(shafts, highest));
        std::size_t untied = 0;
        for (std::size_t p = 0; p < named.size(); ++p) {
            if (by_liftplan) {
                each(p, shaft_set(named[p], highest));
                continue;
            }
            ShaftSet moved = shaft_set({}, highest);
            for (const int treadle : named[p]) {
                if (static_cast<std::size_t>(treadle) > tied.size()) {
                    ++untied;
                    continue;
                }
                const ShaftSet& more = tied[static_cast<std::size_t>(treadle - 1)];
                for (std::size_t i = 0; i < moved.size(); ++i) moved[i] |= more[i];
            }
            each(p, moved);
        }
        if (untied > 0) warn("%zu treadles in [TREADLING] that [TIEUP] does not tie: they move nothing", untied);
    }

    void interlace(const Section& threading, const Section& picks, bool by_liftplan)
    {
        const auto shafts = lists(threading, "shaft", draft_.ends.size());
        const bool sinking = !rising_ && !by_liftplan;
        if (!rising_ && by_liftplan) warn("Rising Shed=no: [LIFTPLAN] still names the shafts that are lifted");

        int highest = 0, unthreaded = 0;
        for (const auto& end : shafts) {
            unthreaded += end.empty() ? 1 : 0;
            if (!end.empty()) highest = std::max(highest, end.back());
        }
        if (declared_shafts_ > 0 && highest > declared_shafts_)
            warn("[THREADING] names shaft %d of %lld: taken as it stands", highest,
                 static_cast<long long>(declared_shafts_));
        if (unthreaded > 0) warn("%d ends on no shaft: the weft lies over them everywhere", unthreaded);

        const std::size_t ends = draft_.ends.size();
        std::vector<ShaftSet> sets(ends); // of ends on several shafts
        for (std::size_t e = 0; e < ends; ++e)
            if (shafts[e].size() > 1) sets[e] = shaft_set(shafts[e], highest);
        draft_.warp_up.assign(ends * draft_.picks.size(), 0);
        shafts_of_picks(picks, by_liftplan, highest, [&](std::size_t p, const ShaftSet& moved) {
            for (std::size_t e = 0; e < ends; ++e) {
                if (shafts[e].empty()) continue;
                std::uint64_t any = 0;
                if (sets[e].empty()) {
                    any = moved[static_cast<std::size_t>(shafts[e][0]) / 64] >> (shafts[e][0] % 64) & 1;
                } else {
                    for (std::size_t i = 0; i < moved.size(); ++i) any |= moved[i] & sets[e][i];
                }
                draft_.warp_up[p * ends + e] = (any != 0) != sinking ? 1 : 0;
            }
        });
    }

    void read_colour_table()
    {
        const Section* table = section("color table");
        if (!table || table->numbers.empty()) {
            warn("no [COLOR TABLE]: the yarns' own colours are used");
            return;
        }
        double low = 0, high = 255;
        const Entry* range = word("color palette", "range");
        const auto parts = range ? split(range->value) : std::vector<std::string>();
        if (!range)
            warn("no colour Range: taken as 0,255");
        else if (parts.size() < 2 || !read_number(parts[0], low) || !read_number(parts[1], high) || !(high > low) ||
                 !std::isfinite(high - low)) {
            warn("line %d: colour Range=%s: taken as 0,255", range->line, printable(range->value).c_str());
            low = 0, high = 255;
        }
        const Entry* form = word("color palette", "form");
        if (form && lower(form->value) != "rgb")
            warn("line %d: colour Form=%s: read as RGB", form->line, printable(form->value).c_str());
        int outside = 0, first_outside = 0;
        for (const auto& [number, entry] : table->numbers) {
            if (number < 1 || number > colour_limit) continue;
            const auto values = split(entry.value);
            glm::vec3 colour(0);
            for (std::size_t c = 0; c < 3; ++c) {
                double value = 0;
                if (c >= values.size() || !read_number(values[c], value) || !std::isfinite(value))
                    throw InputError(name_, entry.line, "colour \"%s\", expected three numbers",
                                     printable(entry.value).c_str());
                if (value < low || value > high) ++outside, first_outside = first_outside ? first_outside : entry.line;
                const float unit = static_cast<float>(std::clamp((value - low) / (high - low), 0.0, 1.0));
                colour[static_cast<int>(c)] = linear_from_srgb(unit);
            }
            if (draft_.colours.size() < static_cast<std::size_t>(number))
                draft_.colours.resize(static_cast<std::size_t>(number), glm::vec3(1));
            draft_.colours[static_cast<std::size_t>(number - 1)] = colour;
            has_colour_.resize(draft_.colours.size(), 0);
            has_colour_[static_cast<std::size_t>(number - 1)] = 1;
        }
        if (outside > 0)
            warn("%d colour values outside the Range, the first on line %d: clamped", outside, first_outside);
    }

    // Index into the table from "4" or "4,255,0,0"; -1 and a count where there is no such colour.
    int colour_index(const Entry& entry)
    {
        std::int64_t value = 0;
        if (!read_number(split(entry.value)[0], value) || value < 1 ||
            value > static_cast<std::int64_t>(has_colour_.size()) ||
            !has_colour_[static_cast<std::size_t>(value - 1)]) {
            ++bad_colours_;
            if (first_bad_colour_.empty())
                first_bad_colour_ = "line " + std::to_string(entry.line) + ": " + printable(entry.value);
            return -1;
        }
        return static_cast<int>(value - 1);
    }

    double metres_per_unit(const std::string& system)
    {
        const Entry* entry = word(system.c_str(), "units");
        const std::string unit = entry ? lower(entry->value) : "";
        if (unit.rfind("inch", 0) == 0 || unit == "in") return 0.0254;
        if (unit.rfind("deci", 0) == 0) return 0.0254 / 720;
        if (unit.rfind("centim", 0) == 0 || unit == "cm") return 0.01;
        warn("[%s] %s: lengths taken as centimetres", system.c_str(),
             entry ? ("Units=" + printable(entry->value)).c_str() : "gives no Units");
        return 0.01;
    }

    // A length in metres; 0 where it is absent or makes no sense for a thread.
    float length(const Entry* entry, double unit_m)
    {
        double value = 0;
        if (!entry) return 0;
        if (!read_number(entry->value, value) || !(value * unit_m >= 1e-6 && value * unit_m <= 0.1)) {
            ++bad_lengths_;
            if (first_bad_length_.empty())
                first_bad_length_ = "line " + std::to_string(entry->line) + ": " + printable(entry->value);
            return 0;
        }
        return static_cast<float>(value * unit_m);
    }

    void read_threads(const std::string& system, std::vector<DraftThread>& threads)
    {
        const Entry* spacing = word(system.c_str(), "spacing");
        const Entry* thickness = word(system.c_str(), "thickness");
        const Section* spacings = section((system + " spacing").c_str());
        const Section* thicknesses = section((system + " thickness").c_str());
        const bool lengths = spacing || thickness || (spacings && !spacings->numbers.empty()) ||
                             (thicknesses && !thicknesses->numbers.empty());
        const double unit_m = lengths ? metres_per_unit(system) : 0.01;
        DraftThread usual;
        usual.spacing_m = length(spacing, unit_m);
        usual.thickness_m = length(thickness, unit_m);
        if (!spacing) warn("[%s] gives no Spacing: the yarns' own is used", system.c_str());
        const Entry* colour = word(system.c_str(), "color");
        if (colour && !draft_.colours.empty()) usual.colour = colour_index(*colour);
        if (usual.colour < 0 && !draft_.colours.empty())
            usual.colour = static_cast<int>(std::find(has_colour_.begin(), has_colour_.end(), 1) - has_colour_.begin());
        std::fill(threads.begin(), threads.end(), usual);

        const auto each = [&](const Section* from, auto&& set) {
            if (from)
                for (const auto& [number, entry] : from->numbers)
                    if (number >= 1 && number <= static_cast<std::int64_t>(threads.size()))
                        set(threads[static_cast<std::size_t>(number - 1)], entry);
        };
        each(spacings, [&](DraftThread& thread, const Entry& entry) {
            if (const float m = length(&entry, unit_m); m > 0) thread.spacing_m = m;
        });
        each(thicknesses, [&](DraftThread& thread, const Entry& entry) {
            if (const float m = length(&entry, unit_m); m > 0) thread.thickness_m = m;
        });
        std::size_t coloured = 0;
        each(section((system + " colors").c_str()), [&](DraftThread& thread, const Entry& entry) {
            ++coloured;
            if (const int index = draft_.colours.empty() ? -1 : colour_index(entry); index >= 0) thread.colour = index;
        });
        if (!draft_.colours.empty() && coloured < threads.size() && !colour)
            warn("%zu of %zu threads of [%s] have no colour: took colour %d", threads.size() - coloured, threads.size(),
                 system.c_str(), usual.colour + 1);
    }

    void flush_counts()
    {
        if (bad_colours_ > 0)
            warn("%d colours that the table does not hold (%s): replaced by the default", bad_colours_,
                 first_bad_colour_.c_str());
        if (bad_lengths_ > 0) warn("%d lengths out of bounds (%s): ignored", bad_lengths_, first_bad_length_.c_str());
    }

    std::string name_;
    std::map<std::string, Section> sections_;
    std::string last_section_;
    int last_line_ = 0;
    bool cut_ = false; // the last line has text and no line end
    bool rising_ = true;
    std::int64_t declared_shafts_ = 0;
    std::vector<char> has_colour_;
    int bad_colours_ = 0, bad_lengths_ = 0;
    std::string first_bad_colour_, first_bad_length_;
    Draft draft_;
};

} // namespace

Draft parse_wif(const std::string& text, const std::string& name)
{
    return WifReader(text, name).read();
}

Draft read_wif(const std::string& path)
{
    const std::string text = read_file(path, file_limit);
    if (text.empty()) throw InputError(path, 0, "empty file, expected a WIF draft");
    return parse_wif(text, path);
}

std::string format_wif(const Draft& draft, const std::string& version)
{
    const std::size_t ends = draft.ends.size(), picks = draft.picks.size();
    std::map<std::vector<char>, int> shaft_of; // distinct columns of the drawdown
    std::vector<int> threading;
    std::vector<std::vector<int>> lifts(picks);
    for (std::size_t e = 0; e < ends; ++e) {
        std::vector<char> column(picks);
        for (std::size_t p = 0; p < picks; ++p) column[p] = draft.warp_on_top(p, e) ? 1 : 0;
        const auto [place, is_new] = shaft_of.try_emplace(column, static_cast<int>(shaft_of.size()) + 1);
        threading.push_back(place->second);
        for (std::size_t p = 0; is_new && p < picks; ++p)
            if (column[p]) lifts[p].push_back(place->second);
    }
    const bool colours = !draft.colours.empty();
    const std::vector<DraftThread>* systems[] = {&draft.ends, &draft.picks};
    const char* names[] = {"WARP", "WEFT"};
    struct {
        const char* section;
        const char* word;
        float DraftThread::*member;
    } const lengths[] = {{"SPACING", "Spacing", &DraftThread::spacing_m},
                         {"THICKNESS", "Thickness", &DraftThread::thickness_m}};
    // A length that all threads share is said once.
    const auto is_one = [](const std::vector<DraftThread>& threads, float DraftThread::*member) {
        return std::all_of(threads.begin(), threads.end(),
                           [&](const DraftThread& thread) { return thread.*member == threads[0].*member; });
    };
    const auto centimetres = [](float metres) { return format_text("%.6g", static_cast<double>(metres) * 100); };

    std::string out = "[WIF]\nVersion=1.1\nDate=April 20, 1997\nDevelopers=wif@mhsoft.com\nSource Program=selvedge\n";
    out += "Source Version=" + version +
           "\n\n[CONTENTS]\nTEXT=true\nWEAVING=true\nWARP=true\nWEFT=true\nTHREADING=true\n"
           "LIFTPLAN=true\n";
    if (colours) out += "COLOR PALETTE=true\nCOLOR TABLE=true\nWARP COLORS=true\nWEFT COLORS=true\n";
    for (std::size_t s = 0; s < 2; ++s)
        for (const auto& length : lengths)
            if (!is_one(*systems[s], length.member)) out += format_text("%s %s=true\n", names[s], length.section);
    out += "\n[TEXT]\nTitle=" + printable(draft.title) + "\n";
    out += format_text("\n[WEAVING]\nShafts=%zu\nTreadles=0\nRising Shed=true\n", shaft_of.size());
    for (std::size_t s = 0; s < 2; ++s) {
        out += format_text("\n[%s]\nThreads=%zu\nUnits=centimeters\n", names[s], systems[s]->size());
        for (const auto& length : lengths)
            if (is_one(*systems[s], length.member) && systems[s]->front().*length.member > 0)
                out += format_text("%s=%s\n", length.word, centimetres(systems[s]->front().*length.member).c_str());
    }

    out += "\n[THREADING]\n";
    for (std::size_t e = 0; e < ends; ++e) out += format_text("%zu=%d\n", e + 1, threading[e]);
    out += "\n[LIFTPLAN]\n";
    for (std::size_t p = 0; p < picks; ++p) {
        out += format_text("%zu=", p + 1);
        std::sort(lifts[p].begin(), lifts[p].end());
        for (std::size_t i = 0; i < lifts[p].size(); ++i) out += format_text(i ? ",%d" : "%d", lifts[p][i]);
        out += lifts[p].empty() ? "0\n" : "\n";
    }
    if (colours) {
        const int top = range_for(draft.colours);
        out += format_text("\n[COLOR PALETTE]\nEntries=%zu\nForm=RGB\nRange=0,%d\n\n[COLOR TABLE]\n",
                           draft.colours.size(), top);
        for (std::size_t i = 0; i < draft.colours.size(); ++i) {
            const glm::vec3 c = draft.colours[i];
            out += format_text("%zu=%d,%d,%d\n", i + 1, step_of(c.x, top), step_of(c.y, top), step_of(c.z, top));
        }
    }
    for (std::size_t s = 0; s < 2; ++s) {
        const std::vector<DraftThread>& threads = *systems[s];
        if (colours) {
            out += format_text("\n[%s COLORS]\n", names[s]);
            for (std::size_t t = 0; t < threads.size(); ++t)
                if (threads[t].colour >= 0) out += format_text("%zu=%d\n", t + 1, threads[t].colour + 1);
        }
        for (const auto& length : lengths) {
            if (is_one(threads, length.member)) continue;
            out += format_text("\n[%s %s]\n", names[s], length.section);
            for (std::size_t t = 0; t < threads.size(); ++t)
                if (threads[t].*length.member > 0)
                    out += format_text("%zu=%s\n", t + 1, centimetres(threads[t].*length.member).c_str());
        }
    }
    return out;
}

} // namespace selvedge
