// bake/weaves.cpp: built-in weaves, ISO 9354 codes, rows of x and dots.
#include "weaves.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdint>
#include <numeric>

#include "error.hpp"
#include "image.hpp"

namespace selvedge
{

namespace
{

constexpr int number_limit = 64; // any number in a name is below it; so are an ISO code's groups and steps
constexpr int crepe_ends = 16;   // repeat of a crepe that names none
constexpr int crepe_longest_float = 3;
constexpr std::size_t text_limit = std::size_t(16) << 20; // bytes: room for the largest draft

Draft empty_draft(const std::string& title, std::size_t ends, std::size_t picks)
{
    Draft draft;
    draft.title = title;
    draft.ends.resize(ends);
    draft.picks.resize(picks);
    draft.warp_up.assign(ends * picks, 0);
    return draft;
}

// The draft where rule(end, pick) says which end is over which pick.
template <class Rule> Draft drawn(int ends, int picks, Rule&& rule)
{
    Draft draft = empty_draft({}, static_cast<std::size_t>(ends), static_cast<std::size_t>(picks));
    for (int p = 0; p < picks; ++p)
        for (int e = 0; e < ends; ++e) draft.warp_up[static_cast<std::size_t>(p * ends + e)] = rule(e, p) ? 1 : 0;
    return draft;
}

int wrapped(int value, int count)
{
    return (value % count + count) % count;
}

int sum(const std::vector<int>& numbers)
{
    return std::accumulate(numbers.begin(), numbers.end(), 0);
}

// {2, 1} -> over, over, under.
std::vector<char> floats_of(const std::vector<int>& numbers, bool over = true)
{
    std::vector<char> out;
    for (const int n : numbers) {
        out.insert(out.end(), static_cast<std::size_t>(n), over ? 1 : 0);
        over = !over;
    }
    return out;
}

// Every end weaves `floats` upward, moved up by its own number of picks.
Draft moved_ends(const std::vector<char>& floats, const std::vector<int>& up)
{
    const int picks = static_cast<int>(floats.size());
    return drawn(static_cast<int>(up.size()), picks, [&](int e, int p) {
        return floats[static_cast<std::size_t>(wrapped(p - up[static_cast<std::size_t>(e)], picks))] != 0;
    });
}

// Smallest step that spreads the binding points: coprime with n and neither 1 nor n - 1 (those are twills); 0 if none.
int satin_step(int n)
{
    for (int step = 2; step <= n - 2; ++step)
        if (std::gcd(step, n) == 1) return step;
    return 0;
}

// A pattern's words: "twill 3/1 S" is {"twill", {{3, 1}}, 'S'}, "herringbone 2/2 8" {"herringbone", {{2, 2}, {8}}, 0}.
struct Words {
    std::string name;
    std::vector<std::vector<int>> numbers;
    char way = 0;
    bool sound = true;
};

Words words_of(const std::string& pattern)
{
    Words out;
    std::size_t at = 0;
    while (at < pattern.size() && out.sound) {
        const std::size_t end = std::min(pattern.find(' ', at), pattern.size());
        const std::string word = pattern.substr(at, end - at);
        at = end + 1;
        if (word.empty()) continue;
        if (word == "S" || word == "Z") {
            out.sound = out.way == 0 && !out.numbers.empty();
            out.way = word[0];
        } else if (std::isdigit(static_cast<unsigned char>(word[0]))) {
            std::vector<int> numbers;
            int value = 0;
            bool digits = false;
            for (const char c : word + "/") {
                if (c == '/') {
                    out.sound = out.sound && digits;
                    numbers.push_back(value);
                    value = 0, digits = false;
                } else if (std::isdigit(static_cast<unsigned char>(c))) {
                    value = std::min(value * 10 + (c - '0'), 1 << 20);
                    digits = true;
                } else {
                    out.sound = false;
                }
            }
            out.numbers.push_back(numbers);
        } else {
            out.sound = out.sound && out.numbers.empty() && out.way == 0;
            for (const char c : word)
                if (c < 'a' || c > 'z') out.sound = false;
            out.name += (out.name.empty() ? "" : " ") + word;
        }
    }
    return out;
}

// What a weave's maker may ask of the words. A maker returns an empty draft where the words do not fit its form.
using Maker = Draft (*)(const Words&);

bool in_range(const std::vector<int>& numbers)
{
    return std::all_of(numbers.begin(), numbers.end(), [](int n) { return n >= 1 && n < number_limit; });
}

bool fits(const Words& words, std::size_t lists_from, std::size_t lists_to, bool may_lean = false)
{
    return words.numbers.size() >= lists_from && words.numbers.size() <= lists_to && (may_lean || words.way == 0) &&
           std::all_of(words.numbers.begin(), words.numbers.end(), in_range);
}

// "N" stands for "N/N".
std::vector<int> pair_of(const Words& words)
{
    std::vector<int> numbers = words.numbers[0];
    if (numbers.size() == 1) numbers.push_back(numbers[0]);
    return numbers;
}

Draft plain(const Words& words)
{
    if (!fits(words, 0, 1) || (words.numbers.size() == 1 && words.numbers[0] != std::vector<int>{1, 1})) return {};
    return drawn(2, 2, [](int e, int p) { return (e + p) % 2 == 0; });
}

Draft basket(const Words& words)
{
    if (!fits(words, 1, 1) || pair_of(words).size() != 2) return {};
    const int across = pair_of(words)[0], up = pair_of(words)[1];
    return drawn(2 * across, 2 * up, [=](int e, int p) { return (e / across + p / up) % 2 == 0; });
}

Draft warp_rib(const Words& words)
{
    if (!fits(words, 1, 1) || pair_of(words).size() != 2) return {};
    const int over = pair_of(words)[0], under = pair_of(words)[1];
    return drawn(2, over + under, [=](int e, int p) { return (p < over) == (e == 0); });
}

Draft weft_rib(const Words& words)
{
    if (!fits(words, 1, 1) || pair_of(words).size() != 2) return {};
    const int over = pair_of(words)[0], under = pair_of(words)[1]; // of the pick
    return drawn(over + under, 2, [=](int e, int p) { return (e < over) != (p == 0); });
}

// Moves of `ends` neighbouring ends of a twill, from `first` on; Z (right) goes up by one.
std::vector<int> moves(int ends, int first, int step)
{
    std::vector<int> up;
    for (int e = 0; e < ends; ++e) up.push_back(first + e * step);
    return up;
}

bool is_twill(const std::vector<int>& floats)
{
    return floats.size() >= 2 && floats.size() % 2 == 0 && sum(floats) >= 3;
}

Draft twill(const Words& words)
{
    if (!fits(words, 1, 1, true)) return {};
    const std::vector<int>& numbers = words.numbers[0];
    if (numbers.size() < 2 || numbers.size() % 2 != 0) return {};
    // The first pick begins with the first float, whichever way the twill leans.
    return words.way == 'S' ? moved_ends(floats_of(numbers), moves(sum(numbers), 0, -1))
                            : moved_ends(floats_of(numbers), moves(sum(numbers), 1 - numbers[0], 1));
}

Draft broken_twill(const Words& words)
{
    if (!fits(words, 1, 1) || words.numbers[0].size() != 2 || sum(words.numbers[0]) != 4) return {};
    return moved_ends(floats_of(words.numbers[0]), {0, 1, 3, 2});
}

// Up and down again without doubling the ends at the turn.
Draft pointed_twill(const Words& words)
{
    if (!fits(words, 1, 2) || !is_twill(words.numbers[0])) return {};
    const auto floats = floats_of(words.numbers[0]);
    const int turn = words.numbers.size() == 2 ? words.numbers[1][0] : static_cast<int>(floats.size());
    if (turn < 2 || (words.numbers.size() == 2 && words.numbers[1].size() != 1)) return {};
    std::vector<int> up = moves(turn, 0, 1), down = moves(turn, turn, -1);
    up.insert(up.end(), down.begin(), down.end());
    return moved_ends(floats, up);
}

// The lines meet half a repeat apart: with A = B neighbours at the turn weave contrary.
Draft herringbone(const Words& words)
{
    if (!fits(words, 1, 2) || !is_twill(words.numbers[0])) return {};
    const auto floats = floats_of(words.numbers[0]);
    const int picks = static_cast<int>(floats.size());
    const int turn = words.numbers.size() == 2 ? words.numbers[1][0] : 2 * picks;
    if (turn < 2 || (words.numbers.size() == 2 && words.numbers[1].size() != 1)) return {};
    std::vector<int> up = moves(turn, 0, 1), down = moves(turn, turn - 1 - picks / 2, -1);
    up.insert(up.end(), down.begin(), down.end());
    return moved_ends(floats, up);
}

// {threads, step} of a satin's words; step 0 where there is no such satin, threads 0 where the words do not fit.
std::array<int, 2> satin_of(const Words& words)
{
    if (!fits(words, 1, 1) || words.numbers[0].size() > 2) return {0, 0};
    const int n = words.numbers[0][0];
    const int step = words.numbers[0].size() == 2 ? words.numbers[0][1] : satin_step(n);
    return {n, n >= 5 && step >= 2 && step <= n - 2 && std::gcd(step, n) == 1 ? step : 0};
}

Draft satin_or_sateen(const Words& words, bool weft_faced)
{
    const auto [n, step] = satin_of(words);
    if (n == 0 || step == 0) return {};
    return drawn(n, n, [n = n, step = step, weft_faced](int e, int p) { return (e == p * step % n) == weft_faced; });
}

Draft satin(const Words& words)
{
    return satin_or_sateen(words, false);
}
Draft sateen(const Words& words)
{
    return satin_or_sateen(words, true);
}

// Longest run of equal marks around the ring.
int longest_run(const std::vector<char>& ring)
{
    int longest = 0, run = 0;
    for (std::size_t i = 0; i < 2 * ring.size(); ++i) {
        run = i > 0 && ring[i % ring.size()] == ring[(i - 1) % ring.size()] ? run + 1 : 1;
        longest = std::max(longest, run);
    }
    return longest;
}

// No direction and no long float, which is what makes a crepe. From plain weave, pairs of ends trade marks on pairs of
// picks (every thread stays over as often as under, so that all take up the same length), and a trade that would make a
// float longer than three is not made.
Draft crepe(const Words& words)
{
    if (!fits(words, 0, 2)) return {};
    for (const auto& list : words.numbers)
        if (list.size() != 1) return {};
    const int n = words.numbers.empty() ? crepe_ends : words.numbers[0][0];
    if (n < 6 || n % 2 != 0) return {};
    Draft draft = drawn(n, n, [](int e, int p) { return (e + p) % 2 == 0; });
    std::uint64_t state = words.numbers.size() == 2 ? static_cast<std::uint64_t>(words.numbers[1][0]) : 1;
    const auto any = [&] { // splitmix64: the same weave on every machine
        state += 0x9e3779b97f4a7c15u;
        std::uint64_t z = state;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return static_cast<int>((z ^ (z >> 31)) % static_cast<std::uint64_t>(n));
    };
    const auto mark = [&](int e, int p) -> char& { return draft.warp_up[static_cast<std::size_t>(p * n + e)]; };
    const auto float_is_short = [&](int thread, bool of_warp) {
        std::vector<char> ring;
        for (int i = 0; i < n; ++i) ring.push_back(of_warp ? mark(thread, i) : mark(i, thread));
        return longest_run(ring) <= crepe_longest_float;
    };
    for (int trial = 0; trial < 40 * n * n; ++trial) {
        const int e = any(), f = any(), p = any(), q = any();
        if (e == f || p == q || mark(e, p) == mark(f, p) || mark(e, p) != mark(f, q) || mark(f, p) != mark(e, q))
            continue;
        const auto trade = [&] {
            std::swap(mark(e, p), mark(f, p));
            std::swap(mark(e, q), mark(f, q));
        };
        trade();
        if (!float_is_short(e, true) || !float_is_short(f, true) || !float_is_short(p, false) ||
            !float_is_short(q, false))
            trade();
    }
    return draft;
}

constexpr struct {
    const char* name;
    const char* form; // of what follows the name
    const char* what;
    Maker make;
} weaves[] = {
    {"plain", "", "one over, one under", plain},
    {"basket", " N or N/M", "blocks of N ends and M picks; 2/1 is oxford", basket},
    {"warp rib", " N or N/M", "ends over N picks, under M, neighbours contrary", warp_rib},
    {"weft rib", " N or N/M", "picks over N ends, under M, neighbours contrary", weft_rib},
    {"twill", " A/B[/C/D...] [S|Z]", "ends over A picks, under B; leans right (Z) unless S", twill},
    {"broken twill", " A/B, A + B = 4", "also crowfoot or four-end satin", broken_twill},
    {"pointed twill", " A/B [N]", "turns after N ends: zigzag", pointed_twill},
    {"herringbone", " A/B [N]", "turns after N ends with a cut", herringbone},
    {"satin", " N[/STEP]", "warp on the face; STEP ends to the right each pick", satin},
    {"sateen", " N[/STEP]", "weft on the face", sateen},
    {"crepe", " [N [SEED]]", "N x N, N even from 6, no line and no float over 3", crepe},
};

[[noreturn]] void refuse_unknown(const std::string& pattern, const std::string& file, int line)
{
    std::string list;
    for (const auto& weave : weaves) list += (list.empty() ? "" : "; ") + std::string(weave.name) + weave.form;
    throw InputError(
        file, line,
        "unknown pattern \"%s\", expected %s (numbers below %d); an ISO 9354 code such as 20-0201-01-01; or "
        "{\"wif\": \"FILE\"}, {\"text\": \"FILE\"}, {\"rows\": [\"x.\", \".x\"]}",
        printable(pattern).c_str(), list.c_str(), number_limit);
}

// The pairs of digits of one part of a code; empty where it holds anything else.
std::vector<int> digit_pairs(const std::string& part)
{
    std::string digits;
    for (const char c : part) {
        if (c == ' ') continue;
        if (!std::isdigit(static_cast<unsigned char>(c))) return {};
        digits += c;
    }
    std::vector<int> out;
    if (digits.size() % 2 == 0)
        for (std::size_t i = 0; i < digits.size(); i += 2)
            out.push_back((digits[i] - '0') * 10 + (digits[i + 1] - '0'));
    return out;
}

Draft iso_weave(const std::string& pattern, const std::string& file, int line)
{
    const auto refuse = [&](const char* part, const char* expected) {
        throw InputError(file, line, "ISO 9354 code \"%s\": %s, expected %s", printable(pattern).c_str(), part,
                         expected);
    };
    std::array<std::vector<int>, 4> parts;
    std::size_t count = 0;
    for (std::size_t from = 0; from <= pattern.size(); ++count) {
        const std::size_t dash = std::min(pattern.find('-', from), pattern.size());
        if (count < parts.size()) parts[count] = digit_pairs(pattern.substr(from, dash - from));
        from = dash + 1;
    }
    if (count != 4 || std::any_of(parts.begin(), parts.end(), [](const auto& part) { return part.empty(); }))
        refuse("not four parts of two-digit numbers", "kind-floats-threads-steps such as 20-0201-01-01");
    const auto& [kind, floats, threads, steps] = parts;
    if (kind.size() != 1 || kind[0] % 10 > 1 || kind[0] / 10 < 1 || kind[0] / 10 > 3)
        refuse("another kind of weave", "10 or 11 (plain), 20 or 21 (twill), 30 or 31 (satin)");
    if (floats.size() % 2 != 0 || !in_range(floats) || sum(floats) >= 4 * number_limit)
        refuse("the floats do not alternate around the repeat", "an even number of floats, each from 01 to 63");
    if (!in_range(threads) || threads.size() >= number_limit)
        refuse("the threads that weave alike", "numbers from 01 to 63");
    const std::vector<char> first = floats_of(floats, kind[0] % 10 == 0);
    const int picks = static_cast<int>(first.size());

    if (kind[0] < 20) {
        if (steps != std::vector<int>{0}) refuse("a plain weave with a step", "00 as the last part");
        if (threads.size() > 1 && threads.size() % 2 != 0)
            refuse("an odd number of groups of ends in a plain weave", "one, or an even number");
        std::vector<char> contrary; // of each end
        const auto groups = threads.size() == 1 ? std::vector<int>{threads[0], threads[0]} : threads;
        for (std::size_t g = 0; g < groups.size(); ++g)
            contrary.insert(contrary.end(), static_cast<std::size_t>(groups[g]), g % 2 ? 1 : 0);
        return drawn(static_cast<int>(contrary.size()), picks, [&](int e, int p) {
            return (first[static_cast<std::size_t>(p)] != 0) != (contrary[static_cast<std::size_t>(e)] != 0);
        });
    }
    if (threads.size() != 1) refuse("several groups of threads in a twill or satin", "one number");
    if (steps.size() >= number_limit) refuse("too many steps", "fewer than 64");
    for (const int step : steps)
        if (step < 1 || step >= picks) refuse("a step outside the repeat", "01 to the number of picks less one");
    std::vector<int> offsets{0};
    const int groups = steps.size() == 1 ? picks / std::gcd(picks, steps[0]) : static_cast<int>(steps.size()) + 1;
    for (int g = 1; g < groups; ++g)
        offsets.push_back(offsets.back() + steps[steps.size() == 1 ? 0 : static_cast<std::size_t>(g - 1)]);
    std::vector<int> up;
    for (const int offset : offsets) up.insert(up.end(), static_cast<std::size_t>(threads[0]), offset);
    return moved_ends(first, up);
}

} // namespace

std::vector<std::string> builtin_weaves()
{
    std::vector<std::string> out;
    for (const auto& weave : weaves) out.push_back(std::string(weave.name) + weave.form + ": " + weave.what);
    out.push_back("20-0201-01-01 and the like: ISO 9354 codes of plain weaves, twills and satins");
    return out;
}

Draft builtin_weave(const std::string& pattern, const std::string& file, int line)
{
    Draft draft;
    if (!pattern.empty() && std::isdigit(static_cast<unsigned char>(pattern[0]))) {
        draft = iso_weave(pattern, file, line);
    } else {
        const Words words = words_of(pattern);
        for (const auto& weave : weaves)
            if (words.sound && words.name == weave.name) draft = weave.make(words);
        const bool is_satin = words.name == "satin" || words.name == "sateen";
        if (is_satin && draft.ends.empty() && words.sound && satin_of(words)[0] > 0)
            throw InputError(file, line,
                             "pattern \"%s\": no regular satin, expected 5 or at least 7 threads, and a step of 2 or "
                             "more without common factor (irregular ones by ISO 9354 code: 30-0501-01-0203040403)",
                             printable(pattern).c_str());
    }
    if (draft.ends.empty()) refuse_unknown(pattern, file, line);
    draft.title = pattern;
    return draft;
}

Draft weave_from_rows(const std::vector<WeaveRow>& rows, const std::string& name)
{
    if (rows.empty()) throw InputError(name, 0, "no rows, expected rows of x and . such as x. and .x");
    const std::size_t ends = rows[0].text.size(), picks = rows.size();
    if (ends == 0) throw InputError(name, rows[0].line, "an empty row, expected x and .");
    if (ends > std::size_t(thread_limit) || picks > std::size_t(thread_limit) ||
        ends * picks > std::size_t(crossing_limit))
        throw InputError(name, rows[0].line, "%zu ends x %zu picks, expected at most %d of each and %d crossings", ends,
                         picks, thread_limit, crossing_limit);
    Draft draft = empty_draft({}, ends, picks);
    for (std::size_t p = 0; p < picks; ++p) {
        const WeaveRow& row = rows[picks - 1 - p];
        if (row.text.size() != ends)
            throw InputError(name, row.line, "a row of %zu crossings, expected %zu as in the first row",
                             row.text.size(), ends);
        for (std::size_t e = 0; e < ends; ++e) {
            const char c = row.text[e];
            if (c != 'x' && c != 'X' && c != '.')
                throw InputError(
                    name, row.line, "character %zu is %s, expected x (end over pick) or . (under)", e + 1,
                    format_text(c > ' ' && c < 127 ? "\"%c\"" : "byte %d", static_cast<unsigned char>(c)).c_str());
            draft.warp_up[p * ends + e] = c != '.' ? 1 : 0;
        }
    }
    return draft;
}

Draft parse_weave_text(const std::string& text, const std::string& name)
{
    const auto trimmed = [](const std::string& line) {
        const auto from = line.find_first_not_of(" \t");
        return from == std::string::npos ? std::string() : line.substr(from, line.find_last_not_of(" \t") - from + 1);
    };
    std::vector<WeaveRow> rows;
    std::string title;
    std::size_t at = text.rfind("\xEF\xBB\xBF", 0) == 0 ? 3 : 0;
    for (int line = 1; at < text.size(); ++line) {
        const std::size_t end = std::min(text.find_first_of("\r\n", at), text.size());
        const std::string content = trimmed(text.substr(at, end - at));
        at = end + (text.compare(end, 2, "\r\n") == 0 ? 2 : 1);
        if (content.empty()) continue;
        if (content[0] != ';')
            rows.push_back({content, line});
        else if (title.empty())
            title = trimmed(content.substr(1));
    }
    Draft draft = weave_from_rows(rows, name);
    draft.title = title;
    return draft;
}

Draft read_weave_text(const std::string& path)
{
    return parse_weave_text(read_file(path, text_limit), path);
}

} // namespace selvedge
