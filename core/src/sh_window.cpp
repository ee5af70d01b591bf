// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sh.h>

#include "sh_internal.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;

/// Normals on which irradiance is checked: a spherical Fibonacci set (Keinert et al., "Spherical
/// Fibonacci Mapping", 2015), neighbours about 4.5 degrees apart. Irradiance of 6 bands has
/// degree 4, features of some 45 degrees: between the normals it is lower by up to 0.3% of the
/// mean.
constexpr std::size_t kNormals = 2048;

Vec3d normal(std::size_t k)
{
    const double golden = kPi * (3.0 - std::sqrt(5.0));
    const double z = 1.0 - (2.0 * static_cast<double>(k) + 1.0) / kNormals;
    const double r = std::sqrt(1.0 - z * z);
    const double phi = golden * static_cast<double>(k);
    return Vec3d(r * std::cos(phi), r * std::sin(phi), z);
}

/// Y_i at the normals: value[i * kNormals + k].
std::vector<double> makeNormalTable()
{
    std::vector<double> table(kMaxCoefficients * kNormals);
    for (std::size_t k = 0; k < kNormals; ++k) {
        double y[kMaxCoefficients];
        evalShBasis(kMaxBands, normal(k), y);
        for (std::size_t i = 0; i < kMaxCoefficients; ++i) table[i * kNormals + k] = y[i];
    }
    return table;
}

const std::vector<double>& normalTable()
{
    static const std::vector<double> table = makeNormalTable();
    return table;
}

/// One value per degree.
using Degrees = std::array<double, kMaxBands>;

double dot(const Degrees& a, const Degrees& b)
{
    double sum = 0.0;
    for (int l = 0; l < kMaxBands; ++l) sum += a[l] * b[l];
    return sum;
}

Degrees laplacianFactors(double lambda)
{
    Degrees factor;
    windowFactors(ShWindow::Laplacian, kMaxBands, factor.data(), lambda);
    return factor;
}

/// The irradiance of one colour channel, kept apart by degree: a window costs one product each.
class ChannelIrradiance {
public:
    ChannelIrradiance(int bands, const Color* L, int channel)
        : mCount(coefficientCount(bands))
    {
        for (int i = 0; i < mCount; ++i)
            mE[i] = kCosineLobe[degreeOf(i)] * static_cast<double>(L[i][channel]);
    }

    double mean() const { return mE[0] * std::sqrt(0.25 / kPi); }

    Degrees at(const Vec3d& n) const
    {
        double y[kMaxCoefficients];
        evalShBasis(kMaxBands, n, y);
        Degrees e{};
        for (int i = 0; i < mCount; ++i) e[degreeOf(i)] += mE[i] * y[i];
        return e;
    }

    /// Under a window: the number of the lowest of the normals, and the value there.
    std::pair<std::size_t, double> lowest(const Degrees& factor) const
    {
        const std::vector<double>& table = normalTable();
        std::vector<double> e(kNormals, 0.0);
        for (int i = 0; i < mCount; ++i) {
            if (kCosineLobe[degreeOf(i)] == 0.0) continue;
            const double c = factor[degreeOf(i)] * mE[i];
            const double* y = table.data() + i * kNormals;
            for (std::size_t k = 0; k < kNormals; ++k) e[k] += c * y[k];
        }
        const auto found = std::min_element(e.begin(), e.end());
        // A NaN coefficient reaches every normal.
        return {static_cast<std::size_t>(found - e.begin()), *found};
    }

    /// Walks from @a n down to the local minimum between the normals (compass search).
    Vec3d descend(Vec3d n, const Degrees& factor) const
    {
        double value = dot(factor, at(n));
        for (double step = 0.04; step > 1e-5; step *= 0.5) {
            bool moved = true;
            for (int walk = 0; moved && walk < 16; ++walk) {
                moved = false;
                const Vec3d u
                    = n.cross(std::abs(n.x) < 0.5 ? Vec3d(1, 0, 0) : Vec3d(0, 1, 0)).normalized();
                const Vec3d v = n.cross(u);
                for (const Vec3d& side : {u, v, -u, -v}) {
                    const Vec3d candidate = (n + side * step).normalized();
                    const double e = dot(factor, at(candidate));
                    if (!(e < value)) continue;
                    n = candidate;
                    value = e;
                    moved = true;
                    break;
                }
            }
        }
        return n;
    }

private:
    int mCount;
    std::array<double, kMaxCoefficients> mE{};
};

/// Smallest λ ≥ @a start at which Σ f_l(λ) e_l is not negative, by bisection; infinite if there
/// is none.
double lambdaAtNormal(const Degrees& e, double start)
{
    const auto negative = [&](double lambda) { return dot(laplacianFactors(lambda), e) < 0.0; };
    double width = 0x1p-20;
    while (negative(start + width)) {
        width *= 2.0;
        if (width > 0x1p500) return HUGE_VAL;
    }
    double low = start;
    double high = start + width;
    for (int step = 0; step < 60; ++step) {
        const double middle = 0.5 * (low + high);
        (negative(middle) ? low : high) = middle;
    }
    return high;
}

/// Smallest λ that leaves no negative irradiance (to 1e-6 of the mean); 0 when there is none to
/// remove, or when the mean is not positive, where no λ can help. Exchange method: λ for the worst
/// normal alone, then the worst normal under that λ, and so on.
double findLambda(int bands, const Color* L, int channel)
{
    const ChannelIrradiance channelE(bands, L, channel);
    const double mean = channelE.mean();
    if (!(mean > 0.0)) return 0.0;

    double lambda = 0.0;
    for (int round = 0; round < 64; ++round) {
        const Degrees factor = laplacianFactors(lambda);
        const Vec3d worst = channelE.descend(normal(channelE.lowest(factor).first), factor);
        const Degrees e = channelE.at(worst);
        if (!(dot(factor, e) < -1e-6 * mean)) break;
        lambda = lambdaAtNormal(e, lambda);
        if (lambda == HUGE_VAL) return 0.0; // a coefficient is infinite
    }
    return lambda;
}

double fixedFactor(ShWindow window, int bands, int l, double lambda)
{
    const double x = kPi * l / bands;
    const double laplacian = static_cast<double>(l) * (l + 1);
    switch (window) {
    case ShWindow::None:
        return 1.0;
    case ShWindow::Hanning:
        return 0.5 * (1.0 + std::cos(x));
    case ShWindow::Lanczos:
        return l == 0 ? 1.0 : std::sin(x) / x;
    case ShWindow::Laplacian:
        return 1.0 / (1.0 + lambda * laplacian * laplacian);
    }
    return 1.0;
}

} // namespace

void windowFactors(ShWindow window, int bands, double* factor, double lambda)
{
    detail::checkBands(bands);
    if (!(lambda >= 0.0))
        throw Error(ErrorCode::Usage,
            "the lambda of a Laplacian window must not be negative, but is "
                + std::to_string(lambda) + "; use 0 for no window");
    for (int l = 0; l < bands; ++l) factor[l] = fixedFactor(window, bands, l, lambda);
}

double windowSh(ShWindow window, int bands, Color* L)
{
    detail::checkBands(bands);
    double largest = 0.0;
    for (int c = 0; c < 3; ++c) {
        const double lambda = window == ShWindow::Laplacian ? findLambda(bands, L, c) : 0.0;
        largest = std::max(largest, lambda);
        double factor[kMaxBands];
        windowFactors(window, bands, factor, lambda);
        for (int i = 0; i < coefficientCount(bands); ++i)
            L[i][c] = static_cast<float>(factor[degreeOf(i)] * L[i][c]);
    }
    return largest;
}

float minIrradiance(int bands, const Color* L)
{
    detail::checkBands(bands);
    const Degrees noWindow = laplacianFactors(0.0);
    double lowest = HUGE_VAL;
    for (int c = 0; c < 3; ++c) {
        const double channel = ChannelIrradiance(bands, L, c).lowest(noWindow).second;
        if (std::isnan(channel)) return static_cast<float>(channel);
        lowest = std::min(lowest, channel);
    }
    return static_cast<float>(lowest);
}

} // namespace lumivdb
