// bake/knit.cpp: charts worked into loops, built-in structures, repeats.
#include "knit.hpp"

#include <algorithm>
#include <cstdio>
#include <map>
#include <tuple>

#include "error.hpp"

namespace selvedge
{

namespace
{

int floor_div(int a, int b)
{
    return a >= 0 ? a / b : -((b - 1 - a) / b);
}

// Loops on the needle: those that the next stitch there is drawn through.
using Held = std::vector<KnitParent>;

constexpr int from_below = -1; // KnitParent::loop of what the repeat below leaves on needle n: from_below - n

struct Builtin {
    const char* name;
    const char* help;
    std::vector<std::string> rows; // as a person writes them: the top row first
};

const std::vector<Builtin>& builtins()
{
    static const std::vector<Builtin> list = {
        {"jersey", "stocking stitch: knit on the front, purl on the back", {"k"}},
        {"reverse jersey", "the purl side of jersey in front", {"p"}},
        {"rib 1x1", "knit and purl wales in turn; any \"rib AxB\" up to 8", {"kp"}},
        {"garter", "rows of knit and purl in turn", {"p", "k"}},
        {"seed", "knit and purl like a chequerboard", {"kp", "pk"}},
        {"moss", "seed of double height", {"kp", "kp", "pk", "pk"}},
        {"eyelet lace",
         "jersey with holes: a yarn over beside two stitches knitted together",
         {"kkkkkk", "kkkkkk", "kkko/k", "kkkkkk", "kkkkkk", "o/kkkk"}},
    };
    return list;
}

KnitChart chart_of_rows(const std::vector<std::string>& rows)
{
    KnitChart chart;
    chart.columns = static_cast<int>(rows[0].size());
    chart.rows = static_cast<int>(rows.size());
    for (std::size_t r = rows.size(); r-- > 0;)
        for (const char c : rows[r])
            for (std::size_t k = 0; k < std::size(stitch_kinds); ++k)
                if (stitch_kinds[k].symbol == c) chart.cells.push_back({static_cast<Stitch>(k), 0, 0});
    return chart;
}

// Two 1x1 ribs drawn through each other: each row knits every second needle of each bed.
KnitPattern interlock()
{
    KnitPattern pattern;
    pattern.columns = pattern.rows = pattern.rows_per_course = 2;
    for (int row = 0; row < 2; ++row)
        for (int column = 0; column < 2; ++column) {
            KnitLoop loop;
            loop.row = row, loop.column = column;
            loop.face = loop.bed = (row + column) % 2 ? -1 : 1;
            loop.parents = {{static_cast<int>(pattern.loops.size()), 0, -1}};
            pattern.loops.push_back(loop);
        }
    return pattern;
}

KnitPattern cable(int width)
{
    const std::string cross(static_cast<std::size_t>(width), '<'), plain(static_cast<std::size_t>(width), 'k');
    std::vector<std::string> rows(static_cast<std::size_t>(width + 4), "pp" + plain + "pp");
    rows.back() = "pp" + cross + "pp";
    return work_chart(chart_of_rows(rows), {});
}

// How a loop looks from itself: equal for loops that are one pattern's repeats.
using Look = std::tuple<int, int, int, int, std::vector<std::tuple<int, int, int, int>>>;
Look look(const KnitPattern& pattern, const KnitLoop& loop)
{
    std::vector<std::tuple<int, int, int, int>> parents;
    for (const KnitParent& parent : loop.parents) {
        const KnitLoop& other = pattern.loops[static_cast<std::size_t>(parent.loop)];
        parents.emplace_back(other.column + parent.across * pattern.columns - loop.column,
                             other.row + parent.up * pattern.rows - loop.row, other.bed, other.strand);
    }
    return {loop.face, loop.bed, loop.level, loop.strand, parents};
}

// Place of a loop: at most one of a strand in each.
std::tuple<int, int, int, int> place(const KnitLoop& loop)
{
    return {loop.row, loop.column, loop.bed, loop.strand};
}

bool repeats(const KnitPattern& pattern, const std::map<std::tuple<int, int, int, int>, std::size_t>& at,
             const std::vector<Look>& looks, int columns, int rows)
{
    for (std::size_t i = 0; i < pattern.loops.size(); ++i) {
        auto [row, column, bed, strand] = place(pattern.loops[i]);
        const auto other = at.find({(row + rows) % pattern.rows, (column + columns) % pattern.columns, bed, strand});
        if (other == at.end() || looks[other->second] != looks[i]) return false;
    }
    return true;
}

} // namespace

KnitPattern work_chart(const KnitChart& chart, const std::string& file)
{
    const int columns = chart.columns, rows = chart.rows;
    if (columns < 1 || rows < 1 || columns > knit_side_limit || rows > knit_side_limit ||
        columns * rows > knit_loop_limit)
        throw InputError(file, 0, "chart of %d columns x %d rows, expected 1 to %d each and at most %d stitches",
                         columns, rows, knit_side_limit, knit_loop_limit);
    KnitPattern pattern;
    pattern.title = chart.title;
    pattern.columns = columns, pattern.rows = rows;
    pattern.colours = chart.colours;
    pattern.warnings = chart.warnings;

    std::vector<Held> held(static_cast<std::size_t>(columns)), next;
    for (int c = 0; c < columns; ++c) held[static_cast<std::size_t>(c)] = {{from_below - c, 0, 0}};
    for (int row = 0; row < rows; ++row) {
        const KnitCell* cells = chart.cells.data() + static_cast<std::size_t>(row) * static_cast<std::size_t>(columns);
        // Cables change places before the row is knitted.
        std::vector<int> level(static_cast<std::size_t>(columns), 0);
        int takes = 0;
        for (int c = 0; c < columns; ++c) takes += stitch_kinds[static_cast<std::size_t>(cells[c].stitch)].takes;
        if (takes != columns)
            throw InputError(file, cells[0].line,
                             "row %d from the bottom takes %d loops from the row below, expected %d: each yarn over "
                             "needs a decrease in its row",
                             row + 1, takes, columns);
        for (int c = 0, from = 0; c < columns;) {
            const Stitch stitch = cells[c].stitch;
            if (stitch != Stitch::left_cross && stitch != Stitch::right_cross) {
                from += stitch_kinds[static_cast<std::size_t>(stitch)].takes;
                ++c;
                continue;
            }
            int run = 0;
            while (c + run < columns && cells[c + run].stitch == stitch) ++run;
            if (run % 2 || run > 16)
                throw InputError(file, cells[c].line,
                                 "cable of %d stitches at column %d, expected an even number to 16", run, c + 1);
            const int half = run / 2;
            std::rotate(held.begin() + from, held.begin() + from + half, held.begin() + from + run);
            for (int k = 0; k < run; ++k) // after the turn the right strand lies on the left
                level[static_cast<std::size_t>(c + k)] = (k < half) == (stitch == Stitch::left_cross) ? 1 : -1;
            from += run, c += run;
        }
        next.clear();
        for (int c = 0, from = 0; c < columns; ++c) {
            const KnitCell& cell = cells[c];
            const int count = stitch_kinds[static_cast<std::size_t>(cell.stitch)].takes;
            Held taken;
            const auto take = [&](int which) {
                for (const KnitParent& parent : held[static_cast<std::size_t>(from + which)]) taken.push_back(parent);
            };
            switch (cell.stitch) { // the loop in front is the one that the needle enters last
            case Stitch::ssk:
                take(1), take(0);
                break;
            case Stitch::double_decrease:
                take(1), take(0), take(2);
                break;
            default:
                for (int k = 0; k < count; ++k) take(k);
            }
            from += count;
            if (cell.stitch == Stitch::slip) {
                next.push_back(taken);
                continue;
            }
            KnitLoop loop;
            loop.row = row, loop.column = c;
            loop.face = cell.stitch == Stitch::purl || cell.stitch == Stitch::p2tog ? -1 : 1;
            loop.level = level[static_cast<std::size_t>(c)];
            loop.strand = cell.strand;
            const KnitParent itself{static_cast<int>(pattern.loops.size()), 0, 0};
            if (cell.stitch == Stitch::tuck) {
                taken.push_back(itself);
                next.push_back(taken);
            } else {
                loop.parents = taken;
                next.push_back({itself});
            }
            pattern.loops.push_back(loop);
        }
        held.swap(next);
    }
    // What the lowest row takes is what the uppermost row leaves, one repeat below.
    for (KnitLoop& loop : pattern.loops) {
        Held parents;
        for (const KnitParent& parent : loop.parents) {
            if (parent.loop > from_below) {
                parents.push_back(parent);
                continue;
            }
            const int column = from_below - parent.loop;
            for (KnitParent left : held[static_cast<std::size_t>(column)]) {
                if (left.loop <= from_below)
                    throw InputError(file, 0, "column %d is slipped in every row, expected it to be knitted once",
                                     column + 1);
                left.up -= 1;
                parents.push_back(left);
            }
        }
        loop.parents = parents;
    }
    for (int c = 0; c < columns; ++c)
        for (const KnitParent& left : held[static_cast<std::size_t>(c)])
            if (left.loop <= from_below)
                throw InputError(file, 0, "column %d is slipped in every row, expected it to be knitted once", c + 1);
    return pattern;
}

KnitPattern builtin_knit(const std::string& name, const std::string& file, int line)
{
    KnitPattern pattern;
    int a = 0, b = 0, end = 0;
    if (std::sscanf(name.c_str(), "rib %1dx%1d%n", &a, &b, &end) == 2 && end == static_cast<int>(name.size()) &&
        a > 0 && b > 0 && a <= 8 && b <= 8)
        pattern = work_chart(chart_of_rows({std::string(static_cast<std::size_t>(a), 'k') +
                                            std::string(static_cast<std::size_t>(b), 'p')}),
                             file);
    else if (name == "interlock")
        pattern = interlock();
    else if (std::sscanf(name.c_str(), "cable %1d%n", &a, &end) == 1 && end == static_cast<int>(name.size()) && a > 0 &&
             a % 2 == 0)
        pattern = cable(a);
    else
        for (const Builtin& builtin : builtins())
            if (name == builtin.name) pattern = work_chart(chart_of_rows(builtin.rows), file);
    if (pattern.loops.empty()) {
        std::string list;
        for (const Builtin& builtin : builtins()) list += std::string(builtin.name) + ", ";
        throw InputError(file, line, "unknown knit \"%.60s\", expected %srib AxB, interlock, cable N (2, 4, 6, 8)",
                         name.c_str(), list.c_str());
    }
    pattern.title = name;
    return pattern;
}

std::vector<std::string> builtin_knits()
{
    std::vector<std::string> out;
    for (const Builtin& builtin : builtins()) out.push_back(std::string(builtin.name) + ": " + builtin.help);
    out.push_back("interlock: two 1x1 ribs drawn through each other");
    out.push_back("cable N: half of N wales over the other half, purl beside it (2, 4, 6, 8)");
    return out;
}

KnitPattern smallest_repeat(const KnitPattern& pattern)
{
    std::map<std::tuple<int, int, int, int>, std::size_t> at;
    std::vector<Look> looks;
    for (std::size_t i = 0; i < pattern.loops.size(); ++i) {
        at.emplace(place(pattern.loops[i]), i);
        looks.push_back(look(pattern, pattern.loops[i]));
    }
    int columns = pattern.columns, rows = pattern.rows;
    for (int c = 1; c < pattern.columns; ++c)
        if (pattern.columns % c == 0 && repeats(pattern, at, looks, c, 0)) {
            columns = c;
            break;
        }
    for (int r = 1; r < pattern.rows; ++r)
        if (pattern.rows % r == 0 && repeats(pattern, at, looks, 0, r)) {
            rows = r;
            break;
        }
    if (columns == pattern.columns && rows == pattern.rows) return pattern;

    KnitPattern out = pattern;
    out.columns = columns, out.rows = rows;
    out.loops.clear();
    std::map<std::tuple<int, int, int, int>, int> index;
    for (const KnitLoop& loop : pattern.loops)
        if (loop.row < rows && loop.column < columns) {
            index.emplace(place(loop), static_cast<int>(out.loops.size()));
            out.loops.push_back(loop);
        }
    for (KnitLoop& loop : out.loops)
        for (KnitParent& parent : loop.parents) {
            KnitLoop other = pattern.loops[static_cast<std::size_t>(parent.loop)];
            other.column += parent.across * pattern.columns;
            other.row += parent.up * pattern.rows;
            parent.across = floor_div(other.column, columns), parent.up = floor_div(other.row, rows);
            other.column -= parent.across * columns, other.row -= parent.up * rows;
            parent.loop = index.at(place(other));
        }
    return out;
}

KnitPattern repeated(const KnitPattern& pattern, int across, int up)
{
    KnitPattern out = pattern;
    out.columns *= across, out.rows *= up;
    out.loops.clear();
    const int count = static_cast<int>(pattern.loops.size());
    for (int y = 0; y < up; ++y)
        for (int x = 0; x < across; ++x)
            for (KnitLoop loop : pattern.loops) {
                loop.column += x * pattern.columns, loop.row += y * pattern.rows;
                for (KnitParent& parent : loop.parents) {
                    const int px = x + parent.across, py = y + parent.up;
                    parent.across = floor_div(px, across), parent.up = floor_div(py, up);
                    parent.loop += ((py - parent.up * up) * across + px - parent.across * across) * count;
                }
                out.loops.push_back(loop);
            }
    return out;
}

std::vector<KnitParent> children(const KnitPattern& pattern)
{
    std::vector<KnitParent> out(pattern.loops.size(), KnitParent{-1, 0, 0});
    for (std::size_t i = 0; i < pattern.loops.size(); ++i)
        for (const KnitParent& parent : pattern.loops[i].parents)
            out[static_cast<std::size_t>(parent.loop)] = {static_cast<int>(i), -parent.across, -parent.up};
    return out;
}

} // namespace selvedge
