// bake/draft.cpp: built-in weaves, smallest repeat, floats.
#include "draft.hpp"

#include <algorithm>
#include <cstdio>
#include <numeric>

#include "error.hpp"

namespace selvedge
{

namespace
{

constexpr int weave_limit = 64; // threads in a built-in repeat

Draft empty_draft(const std::string& title, int ends, int picks)
{
    Draft draft;
    draft.title = title;
    draft.ends.resize(static_cast<std::size_t>(ends));
    draft.picks.resize(static_cast<std::size_t>(picks));
    draft.warp_up.assign(draft.ends.size() * draft.picks.size(), 0);
    return draft;
}

template <class Rule> Draft fill(Draft draft, Rule&& rule)
{
    for (std::size_t p = 0; p < draft.picks.size(); ++p)
        for (std::size_t e = 0; e < draft.ends.size(); ++e)
            draft.warp_up[p * draft.ends.size() + e] = rule(static_cast<int>(e), static_cast<int>(p)) ? 1 : 0;
    return draft;
}

// Smallest step that spreads the binding points: coprime with n and neither 1 nor n - 1 (those are twills); 0 if none.
int satin_step(int n)
{
    for (int step = 2; step <= n - 2; ++step)
        if (std::gcd(step, n) == 1) return step;
    return 0;
}

bool same(const DraftThread& a, const DraftThread& b)
{
    return a.colour == b.colour && a.spacing_m == b.spacing_m && a.thickness_m == b.thickness_m;
}

// Is the draft the same after a shift of `by` threads? `by` divides the count.
bool repeats_across(const Draft& draft, std::size_t by)
{
    const std::size_t ends = draft.ends.size();
    for (std::size_t e = 0; e + by < ends; ++e) {
        if (!same(draft.ends[e], draft.ends[e + by])) return false;
        for (std::size_t p = 0; p < draft.picks.size(); ++p)
            if (draft.warp_up[p * ends + e] != draft.warp_up[p * ends + e + by]) return false;
    }
    return true;
}

bool repeats_up(const Draft& draft, std::size_t by)
{
    const std::size_t ends = draft.ends.size();
    for (std::size_t p = 0; p + by < draft.picks.size(); ++p) {
        if (!same(draft.picks[p], draft.picks[p + by])) return false;
        const auto row = draft.warp_up.begin() + static_cast<std::ptrdiff_t>(p * ends);
        const auto other = draft.warp_up.begin() + static_cast<std::ptrdiff_t>((p + by) * ends);
        if (!std::equal(row, row + static_cast<std::ptrdiff_t>(ends), other)) return false;
    }
    return true;
}

template <class Test> std::size_t smallest_period(std::size_t count, Test&& repeats)
{
    for (std::size_t by = 1; by < count; ++by)
        if (count % by == 0 && repeats(by)) return by;
    return count;
}

// The block of the first `ends` and `picks`, taken around where it is larger than the draft.
Draft block(const Draft& draft, std::size_t ends, std::size_t picks)
{
    Draft out = draft;
    out.ends.resize(ends);
    out.picks.resize(picks);
    out.warp_up.assign(ends * picks, 0);
    for (std::size_t e = 0; e < ends; ++e) out.ends[e] = draft.ends[e % draft.ends.size()];
    for (std::size_t p = 0; p < picks; ++p) {
        out.picks[p] = draft.picks[p % draft.picks.size()];
        for (std::size_t e = 0; e < ends; ++e)
            out.warp_up[p * ends + e] =
                draft.warp_up[(p % draft.picks.size()) * draft.ends.size() + e % draft.ends.size()];
    }
    return out;
}

} // namespace

std::vector<std::string> builtin_weaves()
{
    return {"plain 1/1", "twill A/B (A over, B under; \" S\" after it leans left)", "basket N/N",
            "satin N or N/STEP (warp on the face)", "sateen N or N/STEP (weft on the face)"};
}

Draft builtin_weave(const std::string& pattern, const std::string& file, int line)
{
    const auto in_range = [](int n) { return n >= 1 && n < weave_limit; };
    int a = 0, b = 0, length = 0;
    char way = 'Z';
    const char* text = pattern.c_str();
    const auto whole = [&](int fields, int wanted) {
        return fields == wanted && static_cast<std::size_t>(length) == pattern.size();
    };

    if (pattern == "plain" || pattern == "plain 1/1")
        return fill(empty_draft("plain 1/1", 2, 2), [](int e, int p) { return (e + p) % 2 == 0; });

    length = 0;
    if ((whole(std::sscanf(text, "twill %d/%d%n", &a, &b, &length), 2) ||
         (whole(std::sscanf(text, "twill %d/%d %c%n", &a, &b, &way, &length), 3) && (way == 'S' || way == 'Z'))) &&
        in_range(a) && in_range(b)) {
        const int n = a + b;
        return fill(empty_draft(pattern, n, n), [=](int e, int p) {
            return (way == 'Z' ? e - p + n : e + p) % n < a; // going up a pick, Z moves one end to the right
        });
    }
    length = 0;
    if (whole(std::sscanf(text, "basket %d/%d%n", &a, &b, &length), 2) && in_range(a) && a == b)
        return fill(empty_draft(pattern, 2 * a, 2 * a), [=](int e, int p) { return (e / a + p / a) % 2 == 0; });

    const bool weft_faced = pattern.rfind("sateen ", 0) == 0;
    if (weft_faced || pattern.rfind("satin ", 0) == 0) {
        const char* numbers = text + (weft_faced ? 7 : 6);
        const std::size_t rest = pattern.size() - (weft_faced ? 7 : 6);
        int n = 0, step = 0, used = 0;
        bool ok = std::sscanf(numbers, "%d%n", &n, &used) == 1 && static_cast<std::size_t>(used) == rest;
        if (ok) {
            step = n < weave_limit ? satin_step(n) : 0;
        } else {
            used = 0;
            ok = std::sscanf(numbers, "%d/%d%n", &n, &step, &used) == 2 && static_cast<std::size_t>(used) == rest;
        }
        if (ok && n >= 5 && n < weave_limit && step >= 2 && step <= n - 2 && std::gcd(step, n) == 1)
            return fill(empty_draft(pattern, n, n), [=](int e, int p) { return (e == p * step % n) == weft_faced; });
        if (ok)
            throw InputError(file, line,
                             "pattern \"%s\": no regular satin, expected 5 or at least 7 threads, and a step "
                             "of 2 or more without common factor",
                             pattern.substr(0, 60).c_str());
    }

    std::string list;
    for (const std::string& weave : builtin_weaves()) list += (list.empty() ? "" : "; ") + weave;
    throw InputError(file, line, "unknown pattern \"%s\", expected %s, or {\"wif\": \"FILE\"}",
                     pattern.substr(0, 60).c_str(), list.c_str());
}

Draft smallest_repeat(const Draft& draft)
{
    const std::size_t ends =
        smallest_period(draft.ends.size(), [&](std::size_t by) { return repeats_across(draft, by); });
    const std::size_t picks =
        smallest_period(draft.picks.size(), [&](std::size_t by) { return repeats_up(draft, by); });
    return block(draft, ends, picks);
}

Draft repeated(const Draft& draft, int across, int up)
{
    return block(draft, draft.ends.size() * static_cast<std::size_t>(across),
                 draft.picks.size() * static_cast<std::size_t>(up));
}

int longest_float(const Draft& draft, bool of_warp)
{
    const std::size_t threads = of_warp ? draft.ends.size() : draft.picks.size();
    const std::size_t crossings = of_warp ? draft.picks.size() : draft.ends.size();
    std::size_t longest = 0;
    for (std::size_t t = 0; t < threads; ++t) {
        const auto up = [&](std::size_t c) { return of_warp ? draft.warp_on_top(c, t) : !draft.warp_on_top(t, c); };
        std::size_t run = 0;
        for (std::size_t c = 0; c < 2 * crossings && run < crossings; ++c) { // twice around: runs over the seam
            run = up(c % crossings) ? run + 1 : 0;
            longest = std::max(longest, run);
        }
    }
    return static_cast<int>(longest);
}

} // namespace selvedge
