// bake/knitout.cpp: knitout to loops, loops to a repeat.
#include "knitout.hpp"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <map>
#include <tuple>

#include "error.hpp"
#include "image.hpp"

namespace selvedge
{

namespace
{

constexpr std::size_t file_limit = std::size_t(16) << 20;
constexpr int machine_loop_limit = 1 << 19; // loops of a whole piece
constexpr std::size_t needle_loop_limit = 64;
constexpr int needle_index_limit = 10000;
constexpr int period_limit = 96; // columns, rows of repeats that are searched for
constexpr int edge_columns = 3;  // at either side of a piece, which may differ from its body

std::string shown(const std::string& word)
{
    std::string out;
    for (const char c : word.substr(0, 24)) out += c >= ' ' && c < 127 ? c : '?';
    return out + (word.size() > 24 ? "..." : "");
}

struct Needle {
    bool back = false, slider = false;
    int index = 0;
    auto key() const { return std::make_tuple(back, slider, index); }
};

// A loop as the machine makes it.
struct MachineLoop {
    int row = 0, line = 0, strand = 0;
    Needle needle;
    std::vector<int> parents;
    int child = -1;
    bool beside = false; // when it was made, the needle across held loops
};

class Machine
{
  public:
    Machine(const std::string& text, const std::string& file) : name(file)
    {
        std::size_t at = text.compare(0, 3, "\xef\xbb\xbf") == 0 ? 3 : 0;
        bool magic = false;
        for (line = 1; at < text.size(); ++line) {
            std::size_t end = text.find('\n', at);
            if (end == std::string::npos) end = text.size();
            std::string row = text.substr(at, end - at);
            at = end + 1;
            if (!magic) {
                const std::string start = ";!knitout-";
                if (row.compare(0, start.size(), start) != 0)
                    throw InputError(name, line, "\"%s\", expected ;!knitout-2", shown(row).c_str());
                if (row[std::min(start.size(), row.size() - 1)] != '2')
                    throw InputError(name, line, "\"%s\", expected version 2", shown(row).c_str());
                magic = true;
                continue;
            }
            row = row.substr(0, row.find(';'));
            words.clear();
            for (std::size_t i = 0; i < row.size();) {
                while (i < row.size() && (row[i] == ' ' || row[i] == '\t' || row[i] == '\r')) ++i;
                const std::size_t from = i;
                while (i < row.size() && row[i] != ' ' && row[i] != '\t' && row[i] != '\r') ++i;
                if (i > from) words.push_back(row.substr(from, i - from));
                if (words.size() > 64) fail("more than 64 words, expected one operation");
            }
            if (!words.empty()) operate();
        }
        line = 0;
        if (!magic) throw InputError(name, 1, "an empty file, expected ;!knitout-2");
        stack_rows();
    }

    std::vector<MachineLoop> loops;
    int rows = 0;
    std::vector<glm::vec3> colours;   // of the strands
    std::vector<std::string> carrier; // of the strands

  private:
    [[noreturn, gnu::format(printf, 2, 3)]] void fail(const char* format, ...) const
    {
        std::va_list arguments;
        va_start(arguments, format);
        const std::string message = format_text_list(format, arguments);
        va_end(arguments);
        throw InputError(name, line, "%s: %s", shown(words[0]).c_str(), message.c_str());
    }

    const std::string& word(std::size_t i, const char* expected) const
    {
        if (i >= words.size()) fail("the line ends, expected %s", expected);
        return words[i];
    }

    Needle needle(std::size_t i) const
    {
        const std::string& text = word(i, "a needle such as f10");
        Needle out;
        std::size_t digits = 1;
        bool good = text[0] == 'f' || text[0] == 'b';
        out.back = text[0] == 'b';
        if (text.size() > 1 && text[1] == 's') {
            out.slider = true;
            digits = 2;
        }
        const auto [end, error] =
            std::from_chars(text.data() + std::min(digits, text.size()), text.data() + text.size(), out.index);
        good = good && error == std::errc() && end == text.data() + text.size() && text.size() > digits &&
               std::abs(out.index) <= needle_index_limit;
        if (!good) fail("needle \"%s\", expected f, b, fs or bs and a number", shown(text).c_str());
        return out;
    }

    char direction(std::size_t i) const
    {
        const std::string& text = word(i, "a direction, + or -");
        if (text != "+" && text != "-") fail("direction \"%s\", expected + or -", shown(text).c_str());
        return text[0];
    }

    int strand_of(const std::string& name_of_carrier)
    {
        for (std::size_t s = 0; s < carrier.size(); ++s)
            if (carrier[s] == name_of_carrier) return static_cast<int>(s);
        if (carrier.size() >= static_cast<std::size_t>(knit_strand_limit))
            fail("more than %d carriers, expected at most that many", knit_strand_limit);
        carrier.push_back(name_of_carrier);
        colours.emplace_back(-1.0f);
        return static_cast<int>(carrier.size()) - 1;
    }

    // Carriers from word i on; yarns that run together count as the first one.
    int strand(std::size_t i)
    {
        const std::string& text = word(i, "a carrier");
        if (!std::binary_search(active.begin(), active.end(), text))
            fail("carrier \"%s\" is not in action, expected in or inhook before", shown(text).c_str());
        return strand_of(text);
    }

    std::vector<int>& held(const Needle& at) { return on_needle[at.key()]; }

    // A new pass where the carriage turns, steps back, changes its carrier, or comes to a needle again.
    int pass_of(const Needle& at, char way, int strand)
    {
        const bool goes_on = way == pass_way && strand == pass_strand &&
                             (way == '+' ? at.index >= pass_index : at.index <= pass_index) &&
                             std::find(pass_used.begin(), pass_used.end(), at.key()) == pass_used.end();
        if (!goes_on) {
            ++passes;
            pass_used.clear();
        }
        // Only needles of the same index can come again while the carriage goes on.
        if (goes_on && at.index != pass_index) pass_used.clear();
        pass_used.push_back(at.key());
        pass_way = way, pass_strand = strand, pass_index = at.index;
        return passes - 1;
    }

    // Each pass becomes the lowest row that lies above what its loops are drawn through, above what lies on its
    // needles, and above the passes of its own carrier: passes of different carriers side by side make one row.
    void stack_rows()
    {
        std::map<std::tuple<bool, bool, int>, int> top;
        std::map<int, int> strand_top;
        for (std::size_t i = 0; i < loops.size();) {
            std::size_t end = i;
            int row = 0;
            const auto above = [&](const auto& rows_by_key, const auto& key) {
                const auto found = rows_by_key.find(key);
                if (found != rows_by_key.end()) row = std::max(row, found->second + 1);
            };
            for (; end < loops.size() && loops[end].row == loops[i].row; ++end) { // row: the pass, until now
                above(top, loops[end].needle.key());
                for (const int parent : loops[end].parents)
                    row = std::max(row, loops[static_cast<std::size_t>(parent)].row + 1);
            }
            above(strand_top, loops[i].strand);
            strand_top[loops[i].strand] = row;
            for (; i < end; ++i) {
                loops[i].row = row;
                top[loops[i].needle.key()] = row;
            }
            rows = std::max(rows, row + 1);
        }
    }

    void make_loop(bool drawn_through)
    {
        const char way = direction(1);
        const Needle at = needle(2);
        if (words.size() == 3) { // knit without yarn drops, tuck without yarn does nothing
            if (drawn_through) held(at).clear();
            return;
        }
        const int yarn = strand(3);
        if (at.slider) fail("a loop on a slider, expected a needle");
        const int pass = pass_of(at, way, yarn);
        if (loops.size() >= static_cast<std::size_t>(machine_loop_limit))
            fail("more than %d loops, expected a piece within that", machine_loop_limit);
        MachineLoop loop;
        loop.row = pass, loop.line = line, loop.strand = yarn, loop.needle = at;
        const auto across = on_needle.find({!at.back, false, at.index});
        loop.beside = across != on_needle.end() && !across->second.empty();
        const int itself = static_cast<int>(loops.size());
        std::vector<int>& here = held(at);
        if (drawn_through) {
            loop.parents.swap(here);
            for (const int parent : loop.parents) loops[static_cast<std::size_t>(parent)].child = itself;
        }
        here.push_back(itself);
        if (here.size() > needle_loop_limit) fail("more than %zu loops on a needle, expected fewer", needle_loop_limit);
        loops.push_back(std::move(loop));
    }

    void transfer()
    {
        const Needle from = needle(1), to = needle(2);
        if (from.back == to.back) fail("between needles of one bed, expected front and back");
        const int front = from.back ? to.index : from.index, back = from.back ? from.index : to.index;
        if (front != back + racking)
            fail("%s and %s do not face each other at racking %d, expected f%d", words[1].c_str(), words[2].c_str(),
                 racking, back + racking);
        std::vector<int>&source = held(from), &target = held(to);
        target.insert(target.end(), source.begin(), source.end());
        source.clear();
        if (target.size() > needle_loop_limit)
            fail("more than %zu loops on a needle, expected fewer", needle_loop_limit);
    }

    void rack()
    {
        const std::string& text = word(1, "a number of needles");
        char* end = nullptr;
        const double value = std::strtod(text.c_str(), &end);
        if (*end != 0 || !(std::abs(value) <= 100))
            fail("racking \"%s\", expected a number of needles", shown(text).c_str());
        // A quarter or half pitch sets the beds for knitting on both; needles face only at whole ones.
        racking = static_cast<int>(std::floor(value));
    }

    void colour()
    {
        if (words.size() < 3) return;
        const std::string& text = words[1];
        int bits = 0;
        const auto [end, error] = std::from_chars(text.data() + 1, text.data() + text.size(), bits, 16);
        if (text.size() != 7 || text[0] != '#' || error != std::errc() || end != text.data() + text.size()) return;
        glm::vec3 linear;
        for (int c = 0; c < 3; ++c) {
            const float v = static_cast<float>((bits >> (16 - 8 * c)) & 255) / 255.0f;
            linear[c] = v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f);
        }
        colours[static_cast<std::size_t>(strand_of(words[2]))] = linear;
    }

    void operate()
    {
        const std::string& what = words[0];
        if (what == "knit") {
            make_loop(true);
        } else if (what == "tuck") {
            make_loop(false);
        } else if (what == "xfer") {
            transfer();
        } else if (what == "drop") {
            held(needle(1)).clear();
        } else if (what == "amiss") {
            needle(1);
        } else if (what == "miss") {
            direction(1), needle(2);
        } else if (what == "rack") {
            rack();
        } else if (what == "in" || what == "inhook") {
            word(1, "a carrier");
            for (std::size_t i = 1; i < words.size(); ++i) {
                const auto place = std::lower_bound(active.begin(), active.end(), words[i]);
                if (place == active.end() || *place != words[i]) active.insert(place, words[i]);
                if (active.size() > 256) fail("more than 256 carriers in action, expected fewer");
            }
        } else if (what == "out" || what == "outhook") {
            word(1, "a carrier");
            for (std::size_t i = 1; i < words.size(); ++i)
                active.erase(std::remove(active.begin(), active.end(), words[i]), active.end());
        } else if (what == "x-vis-color") {
            colour();
        } else if (what == "split") {
            fail("draws a loop out of loops that stay, which is not covered: expected knit, tuck, miss, xfer, drop");
        } else if (what != "releasehook" && what != "stitch" && what != "pause" && what.compare(0, 2, "x-") != 0) {
            throw InputError(name, line,
                             "operation \"%s\", expected knit, tuck, miss, xfer, drop, amiss, rack, stitch, pause, in, "
                             "out, inhook, outhook, releasehook or x-...",
                             shown(what).c_str());
        }
    }

    const std::string& name;
    int line = 1, racking = 0;
    std::vector<std::string> words, active;
    std::map<std::tuple<bool, bool, int>, std::vector<int>> on_needle;
    // the pass of the carriage
    char pass_way = 0;
    int pass_strand = -1, pass_index = 0;
    int passes = 0;
    std::vector<std::tuple<bool, bool, int>> pass_used; // needles of index pass_index
};

// The piece as a grid: which loops lie in each place, and what they look like.
class Piece
{
  public:
    Piece(const Machine& of, const std::string& file) : machine(of), name(file)
    {
        // Loops that hold the fabric: those that are knitted again.
        std::map<int, int> uses;
        int beside = 0, count = 0;
        for (const MachineLoop& loop : machine.loops)
            if (loop.child >= 0) {
                ++uses[loop.needle.index];
                beside += loop.beside ? 1 : 0;
                ++count;
            }
        if (count == 0) throw InputError(name, 0, "no loop is drawn through another, expected a fabric");
        is_double = 4 * beside > count;
        knitted = static_cast<std::size_t>(count);
        for (const auto& [index, times] : uses) column_of.emplace(index, static_cast<int>(column_of.size()));
        columns = static_cast<int>(column_of.size()), rows = machine.rows;
        if (columns > knit_side_limit || static_cast<long>(columns) * rows > 4L * machine_loop_limit)
            throw InputError(name, 0, "%d needles x %d rows, expected a piece of at most %d needles", columns, rows,
                             knit_side_limit);
        cell.assign(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows), 0);
        std::map<std::vector<int>, int> looks; // of all loops in a cell
        std::map<int, std::vector<int>> members;
        for (std::size_t i = 0; i < machine.loops.size(); ++i)
            if (const int at = place(static_cast<int>(i)); at >= 0) members[at].push_back(static_cast<int>(i));
        for (auto& [at, list] : members) {
            std::sort(list.begin(), list.end(), [&](int a, int b) { return bed(a) < bed(b); });
            std::vector<int> look;
            for (const int i : list) {
                const MachineLoop& loop = machine.loops[static_cast<std::size_t>(i)];
                look.insert(look.end(), {loop.needle.back ? 1 : 0, loop.strand, loop.child < 0 ? 1 : 0,
                                         static_cast<int>(loop.parents.size())});
                for (const int p : loop.parents) {
                    const int from = place(p);
                    look.insert(look.end(), {from < 0 ? 9999 : from % columns - at % columns,
                                             loop.row - machine.loops[static_cast<std::size_t>(p)].row, bed(p)});
                }
            }
            cell[static_cast<std::size_t>(at)] =
                looks.try_emplace(look, static_cast<int>(looks.size()) + 1).first->second;
        }
        loops_at = std::move(members);
    }

    KnitPattern repeat()
    {
        const int edge = columns > 4 * edge_columns ? edge_columns : columns > 6 ? 1 : 0;
        const int low = edge, high = columns - edge;
        // Rows that look like the one `up` rows above, for each `up`; the longest run of them.
        int best_area = 0;
        KnitPattern best;
        for (int up = 1; up <= std::min(period_limit, rows / 2); ++up) {
            int run = 0, longest = 0, start = 0;
            for (int row = 0; row + up < rows; ++row) {
                run = same_rows(row, row + up, low, high) ? run + 1 : 0;
                if (run > longest) longest = run, start = row - run + 1;
            }
            if (longest < up || 2 * (longest + up) < rows - 2) continue; // not the body of the piece
            // Some rows in, where cast-on and transfers are forgotten.
            const int first = start + std::max(0, (longest + up) / 2 - up / 2 - (longest + up) % 2);
            const int from = std::min(first, start + longest);
            for (int across = 1; across <= std::min(period_limit, (high - low) / 2); ++across) {
                if (best_area && up * across >= best_area) break;
                bool same = true;
                for (int row = from; row < from + up && same; ++row)
                    for (int c = low; c + across < high && same; ++c) same = look(row, c) == look(row, c + across);
                if (!same) continue;
                KnitPattern pattern;
                if (!cut(from, from + up, low + (high - low) / 2 - across / 2, across, pattern)) continue;
                best = pattern, best_area = up * across;
                break;
            }
        }
        if (best_area) return best;
        // No smaller repeat: the whole body, edges included or not.
        const auto [from, to] = body();
        if (to == from)
            throw InputError(name, 0,
                             "no row whose loops are drawn through others and knitted again, expected a fabric");
        for (const int side : {0, edge})
            for (int top = to; top > from && to - top < 4; --top)
                for (int bottom = from; bottom < top && bottom - from < 4; ++bottom)
                    if (cut(bottom, top, side, columns - 2 * side, best) && 2 * best.loops.size() > knitted)
                        return best;
        if (cut(from, to, 0, columns, best))
            throw InputError(name, 0,
                             "no repeat: the longest even run is %d of %d rows, expected a fabric that goes on",
                             to - from, rows);
        throw InputError(
            name, open_line,
            "this loop stays open where %d needles x %d rows are repeated, expected a fabric that goes on: "
            "each loop knitted once, no shaping",
            columns, to - from);
    }

  private:
    int bed(int loop) const
    {
        return is_double ? (machine.loops[static_cast<std::size_t>(loop)].needle.back ? -1 : 1) : 0;
    }
    int place(int loop) const // cell, -1 where the loop belongs to no column
    {
        const MachineLoop& l = machine.loops[static_cast<std::size_t>(loop)];
        const auto column = column_of.find(l.needle.index);
        return column == column_of.end() ? -1 : l.row * columns + column->second;
    }
    int look(int row, int column) const
    {
        return cell[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) +
                    static_cast<std::size_t>(column)];
    }
    bool same_rows(int a, int b, int low, int high) const
    {
        const auto row = [&](int r) { return cell.begin() + static_cast<std::ptrdiff_t>(r) * columns; };
        return std::equal(row(a) + low, row(a) + high, row(b) + low);
    }

    // Rows between cast-on and bind-off: the longest run whose loops are nearly all drawn through others and knitted
    // again.
    std::pair<int, int> body() const
    {
        std::vector<int> good(static_cast<std::size_t>(rows), 0), all(static_cast<std::size_t>(rows), 0);
        for (const MachineLoop& loop : machine.loops) {
            ++all[static_cast<std::size_t>(loop.row)];
            if (!loop.parents.empty() && loop.child >= 0) ++good[static_cast<std::size_t>(loop.row)];
        }
        int run = 0, longest = 0, end = 0;
        for (int row = 0; row < rows; ++row) {
            const std::size_t r = static_cast<std::size_t>(row);
            run = all[r] > 0 && 10 * good[r] >= 7 * all[r] ? run + 1 : 0;
            if (run > longest) longest = run, end = row + 1;
        }
        return {end - longest, end};
    }

    // Rows from...to, `width` columns from `left` on, as a pattern that closes both ways. False where it does not.
    bool cut(int from, int to, int left, int width, KnitPattern& pattern)
    {
        const auto open = [&](int loop) {
            open_line = machine.loops[static_cast<std::size_t>(loop)].line;
            return false;
        };
        const int height = to - from;
        if (width < 1 || height < 1 || width > knit_side_limit || height > knit_side_limit) return false;
        pattern = {};
        pattern.columns = width, pattern.rows = height;
        std::map<std::tuple<int, int, int>, int> index; // row, column, bed
        std::vector<int> source;
        for (int row = from; row < to; ++row)
            for (int c = left; c < left + width; ++c)
                if (const auto here = loops_at.find(row * columns + c); here != loops_at.end())
                    for (const int i : here->second) {
                        const MachineLoop& made = machine.loops[static_cast<std::size_t>(i)];
                        KnitLoop loop;
                        loop.row = row - from, loop.column = c - left;
                        loop.face = made.needle.back ? -1 : 1;
                        loop.bed = bed(i);
                        loop.strand = made.strand;
                        if (!index.try_emplace({loop.row, loop.column, loop.bed}, static_cast<int>(source.size()))
                                 .second)
                            return open(i);
                        source.push_back(i);
                        pattern.loops.push_back(loop);
                        if (pattern.loops.size() > static_cast<std::size_t>(knit_loop_limit)) return false;
                    }
        std::vector<int> times(pattern.loops.size(), 0);
        double rows_up = 0;
        for (std::size_t k = 0; k < source.size(); ++k)
            for (const int p : machine.loops[static_cast<std::size_t>(source[k])].parents) {
                const int at = place(p);
                if (at < 0) return open(p);
                int row = at / columns - from, column = at % columns - left;
                rows_up += pattern.loops[k].row - row;
                KnitParent parent;
                parent.up = static_cast<int>(std::floor(static_cast<double>(row) / height));
                parent.across = static_cast<int>(std::floor(static_cast<double>(column) / width));
                row -= parent.up * height, column -= parent.across * width;
                const auto other = index.find({row, column, bed(p)});
                if (other == index.end() || ++times[static_cast<std::size_t>(other->second)] > 1)
                    return open(source[k]);
                parent.loop = other->second;
                pattern.loops[k].parents.push_back(parent);
            }
        if (pattern.loops.empty()) return false;
        if (const auto none = std::find(times.begin(), times.end(), 0); none != times.end())
            return open(source[static_cast<std::size_t>(none - times.begin())]);
        pattern.rows_per_course =
            std::max(1, static_cast<int>(std::lround(rows_up / static_cast<double>(times.size()))));
        return true;
    }

    const Machine& machine;
    const std::string& name;
    bool is_double = false;
    int columns = 0, rows = 0, open_line = 0;
    std::size_t knitted = 0; // loops that are drawn through
    std::map<int, int> column_of;
    std::vector<int> cell;
    std::map<int, std::vector<int>> loops_at;
};

// Strands in use, with colours that differ where the file gives none.
void name_strands(const Machine& machine, KnitPattern& pattern)
{
    constexpr float shades[][3] = {{0.85f, 0.83f, 0.78f}, {0.05f, 0.09f, 0.2f},  {0.45f, 0.06f, 0.05f},
                                   {0.08f, 0.25f, 0.12f}, {0.55f, 0.35f, 0.05f}, {0.25f, 0.25f, 0.25f}};
    std::map<int, int> strand;
    bool stated = false;
    for (KnitLoop& loop : pattern.loops) {
        const auto [row, is_new] = strand.try_emplace(loop.strand, static_cast<int>(strand.size()));
        stated = stated || machine.colours[static_cast<std::size_t>(row->first)].x >= 0;
        loop.strand = row->second;
    }
    if (strand.size() == 1 && !stated) return;
    pattern.colours.assign(strand.size(), glm::vec3(1));
    for (const auto& [from, to] : strand) {
        const glm::vec3 colour = machine.colours[static_cast<std::size_t>(from)];
        const float* shade = shades[static_cast<std::size_t>(to) % std::size(shades)];
        pattern.colours[static_cast<std::size_t>(to)] =
            colour.x >= 0 ? colour : glm::vec3(shade[0], shade[1], shade[2]);
    }
    if (!stated) pattern.warnings.push_back("carriers have no x-vis-color: colours are made up");
}

} // namespace

KnitPattern parse_knitout(const std::string& text, const std::string& name)
{
    const Machine machine(text, name);
    Piece piece(machine, name);
    KnitPattern pattern = piece.repeat();
    name_strands(machine, pattern);
    pattern.title = std::filesystem::path(name).stem().string();
    return pattern;
}

KnitPattern read_knitout(const std::string& path)
{
    return parse_knitout(read_file(path, file_limit), path);
}

} // namespace selvedge
