// bake/draft.cpp: smallest repeat, floats.
#include "draft.hpp"

#include <algorithm>

namespace selvedge
{

namespace
{

bool same(const DraftThread& a, const DraftThread& b)
{
    return a.colour == b.colour && a.spacing_m == b.spacing_m && a.thickness_m == b.thickness_m;
}

// Is the draft the same after a shift of `by` threads? `by` divides the count.
bool repeats_across(const Draft& draft, std::size_t by)
{
    const std::size_t ends = draft.ends.size();
    for (std::size_t e = 0; e + by < ends; ++e)
        if (!same(draft.ends[e], draft.ends[e + by])) return false;
    for (std::size_t p = 0; p < draft.picks.size(); ++p) {
        const char* row = draft.warp_up.data() + p * ends;
        if (!std::equal(row + by, row + ends, row)) return false;
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
