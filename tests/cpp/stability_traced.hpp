// A number that notes every decision made with it: each comparison, each floor and each conversion to an integer. Two
// runs with equal trails took the same branches and read the same texels. Only stability_functions.cpp includes it.
#pragma once
#include <cmath>
#include <cstdint>
#include <glm/glm.hpp>
#include <limits>
#include <type_traits>

namespace stability
{

// Hash of the decisions since it was last set, one for each thread.
inline thread_local std::uint64_t trail;

inline void note(std::uint64_t decision)
{
    trail = (trail ^ decision) * 0x9e3779b97f4a7c15u;
    trail ^= trail >> 29;
}

// A float or double. min, max, clamp, abs and mix are continuous: which side they take is no decision.
template <class F> struct Traced {
    F value;

    Traced() = default;
    template <class N, class = std::enable_if_t<std::is_arithmetic_v<N>>>
    constexpr Traced(N number) : value(static_cast<F>(number))
    {
    }

    explicit operator int() const { return whole<int>(); }
    explicit operator std::uint32_t() const { return whole<std::uint32_t>(); }
    explicit operator double() const { return static_cast<double>(value); }

    constexpr Traced operator-() const { return -value; }
    Traced& operator+=(Traced b) { return *this = value + b.value; }
    Traced& operator-=(Traced b) { return *this = value - b.value; }
    Traced& operator*=(Traced b) { return *this = value * b.value; }
    Traced& operator/=(Traced b) { return *this = value / b.value; }
    friend constexpr Traced operator+(Traced a, Traced b) { return a.value + b.value; }
    friend constexpr Traced operator-(Traced a, Traced b) { return a.value - b.value; }
    friend constexpr Traced operator*(Traced a, Traced b) { return a.value * b.value; }
    friend constexpr Traced operator/(Traced a, Traced b) { return a.value / b.value; }
    friend bool operator<(Traced a, Traced b) { return decide(a.value < b.value); }
    friend bool operator>(Traced a, Traced b) { return decide(a.value > b.value); }
    friend bool operator<=(Traced a, Traced b) { return decide(a.value <= b.value); }
    friend bool operator>=(Traced a, Traced b) { return decide(a.value >= b.value); }
    friend bool operator==(Traced a, Traced b) { return decide(a.value == b.value); }
    friend bool operator!=(Traced a, Traced b) { return decide(a.value != b.value); }

  private:
    static bool decide(bool yes)
    {
        note(yes ? 1u : 2u);
        return yes;
    }
    template <class N> N whole() const
    {
        const N result = static_cast<N>(value);
        note(static_cast<std::uint64_t>(result) + 3u);
        return result;
    }
};

template <class F> Traced<F> min(Traced<F> a, Traced<F> b)
{
    return glm::min(a.value, b.value);
}
template <class F> Traced<F> max(Traced<F> a, Traced<F> b)
{
    return glm::max(a.value, b.value);
}
template <class F> Traced<F> clamp(Traced<F> x, Traced<F> low, Traced<F> high)
{
    return glm::clamp(x.value, low.value, high.value);
}
template <class F> Traced<F> mix(Traced<F> a, Traced<F> b, Traced<F> t)
{
    return glm::mix(a.value, b.value, t.value);
}
template <class F> Traced<F> abs(Traced<F> x)
{
    return glm::abs(x.value);
}
template <class F> Traced<F> floor(Traced<F> x)
{
    const F result = std::floor(x.value);
    note(static_cast<std::uint64_t>(static_cast<std::int64_t>(result)) + 3u);
    return result;
}
template <class F> Traced<F> ceil(Traced<F> x)
{
    const F result = std::ceil(x.value);
    note(static_cast<std::uint64_t>(static_cast<std::int64_t>(result)) + 3u);
    return result;
}
template <class F> Traced<F> sqrt(Traced<F> x)
{
    return std::sqrt(x.value);
}
template <class F> Traced<F> sin(Traced<F> x)
{
    return std::sin(x.value);
}
template <class F> Traced<F> cos(Traced<F> x)
{
    return std::cos(x.value);
}
template <class F> Traced<F> atan(Traced<F> y, Traced<F> x)
{
    return std::atan2(y.value, x.value);
}
template <class F> Traced<F> exp(Traced<F> x)
{
    return std::exp(x.value);
}
template <class F> Traced<F> exp2(Traced<F> x)
{
    return std::exp2(x.value);
}
template <class F> Traced<F> log2(Traced<F> x)
{
    return std::log2(x.value);
}
template <class F> Traced<F> pow(Traced<F> x, Traced<F> y)
{
    return std::pow(x.value, y.value);
}

template <int L, class F> using Vector = glm::vec<L, Traced<F>, glm::defaultp>;

// The same for each component.
template <int L, class F, class Function> Vector<L, F> each(Function function, const Vector<L, F>& a)
{
    Vector<L, F> result;
    for (int k = 0; k < L; ++k) result[k] = function(a[k]);
    return result;
}
template <int L, class F> Vector<L, F> min(const Vector<L, F>& a, const Vector<L, F>& b)
{
    Vector<L, F> result;
    for (int k = 0; k < L; ++k) result[k] = min(a[k], b[k]);
    return result;
}
template <int L, class F> Vector<L, F> max(const Vector<L, F>& a, const Vector<L, F>& b)
{
    Vector<L, F> result;
    for (int k = 0; k < L; ++k) result[k] = max(a[k], b[k]);
    return result;
}
template <int L, class F> Vector<L, F> clamp(const Vector<L, F>& x, const Vector<L, F>& low, const Vector<L, F>& high)
{
    return min(max(x, low), high);
}
template <int L, class F> Vector<L, F> mix(const Vector<L, F>& a, const Vector<L, F>& b, Traced<F> t)
{
    return a * (Traced<F>(1) - t) + b * t;
}
template <int L, class F> Vector<L, F> floor(const Vector<L, F>& a)
{
    return each<L, F>([](Traced<F> x) { return floor(x); }, a);
}
template <int L, class F> Vector<L, F> abs(const Vector<L, F>& a)
{
    return each<L, F>([](Traced<F> x) { return abs(x); }, a);
}
template <int L, class F> Traced<F> length(const Vector<L, F>& a)
{
    return sqrt(glm::dot(a, a));
}
template <int L, class F> Vector<L, F> normalize(const Vector<L, F>& a)
{
    return a * (Traced<F>(1) / sqrt(glm::dot(a, a)));
}

} // namespace stability

template <class F> struct std::numeric_limits<stability::Traced<F>> : std::numeric_limits<F> {
};
