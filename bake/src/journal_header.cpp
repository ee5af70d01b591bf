// SPDX-License-Identifier: Apache-2.0
#include "sample_journal.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/random.h>

#include <cstdio>
#include <type_traits>
#ifdef __x86_64__
#include <emmintrin.h>
#endif

namespace lumivdb {

namespace {

class Lines {
public:
    template <class T> void add(const char* name, const T& value)
    {
        mText += name;
        mText += ' ';
        addValue(value);
        mText += '\n';
    }
    const std::string& text() const { return mText; }

private:
    void addValue(const std::string& value)
    {
        for (const char c : value) mText += c == '\n' ? ' ' : c;
    }
    void addValue(const char* value) { mText += value; }
    void addValue(double value)
    {
        char digits[32];
        std::snprintf(digits, sizeof digits, "%.17g", value);
        mText += digits;
    }
    template <class T, class = std::enable_if_t<std::is_integral_v<T>>> void addValue(T value)
    {
        mText += std::to_string(value);
    }
    std::string mText;
};

// The structures are taken apart member by member, so that a new member does not compile before it
// was decided here whether it changes samples.

void addProbe(Lines& lines, const ProbeOptions& options)
{
    const auto& [rays, maxBounces, contribution, seed, cache] = options;
    static_cast<void>(cache); // solved by the bake, the same for the same options
    lines.add("rays", rays);
    lines.add("max-bounces", maxBounces);
    lines.add("contribution", name(contribution));
    lines.add("seed", seed);
}

void addRefine(Lines& lines, const RefineOptions& options)
{
    const auto& [heuristics, error, gradient, geometry, harmonic, brute, cull, geometryLevel]
        = options;
    std::string words;
    for (const RefineHeuristic h : heuristics)
        words += (words.empty() ? "" : ",") + std::string(name(h));
    lines.add("refine", words);
    lines.add("refine-error", error);
    lines.add("refine-gradient", gradient);
    lines.add("refine-geometry", geometry);
    lines.add("refine-harmonic", harmonic);
    lines.add("refine-brute", brute);
    lines.add("refine-cull", cull);
    lines.add("refine-geometry-level", geometryLevel);
}

void addTarget(Lines& lines, const ErrorTarget& options)
{
    const auto& [error, confidence, maxSamples, chooseRays, chooseGradients] = options;
    lines.add("target-error", error);
    lines.add("confidence", confidence);
    lines.add("max-samples", maxSamples);
    lines.add("choose-rays", chooseRays);
    lines.add("choose-gradients", chooseGradients);
}

void addBounds(Lines& lines, const std::optional<Box3d>& bounds)
{
    const char* const names[] = {"bounds-x", "bounds-y", "bounds-z"};
    for (int a = 0; bounds && a < 3; ++a) {
        Lines ends;
        ends.add("", bounds->min[a]);
        ends.add("", bounds->max[a]);
        lines.add(names[a], ends.text().substr(1));
    }
}

const char* nameOf(GradientMethod method)
{
    switch (method) {
    case GradientMethod::None:
        return "none";
    case GradientMethod::Central:
        return "central";
    case GradientMethod::Analytic:
        return "analytic";
    }
    return "none";
}

} // namespace

std::string processorKind()
{
    std::uint64_t hash = 0;
#ifdef __x86_64__
    constexpr int kValues = 4096; // processors' tables have fewer entries
    for (int i = 0; i < kValues; ++i) {
        const __m128 x = _mm_set_ss(1 + static_cast<float>(i) / kValues);
        for (const __m128 y : {_mm_rcp_ss(x), _mm_rsqrt_ss(x)}) {
            const int bits = _mm_cvtsi128_si32(_mm_castps_si128(y));
            hash = hashCombine(hash, static_cast<std::uint32_t>(bits));
        }
    }
#endif
    char digits[17];
    std::snprintf(digits, sizeof digits, "%016llx", static_cast<unsigned long long>(hash));
    return digits;
}

std::string journalHeader(const BakeOptions& options, const Scene& scene)
{
    const auto& [probe, integrator, bands, gradients, spacing, levels, refine, target, bounds,
        visibility, part, parts, lightGroup, commandLine, threads, journal, resume]
        = options;
    static_cast<void>(commandLine), static_cast<void>(threads);
    static_cast<void>(journal), static_cast<void>(resume);
    Lines lines;
    lines.add("journal-format", 1);
    lines.add("lumivdb", LUMIVDB_VERSION);
    lines.add("sample-revision", kSampleRevision);
    lines.add("kind-of-processor", processorKind());
    lines.add("scene", scene.contentHash);
    addProbe(lines, probe);
    lines.add("integrator", name(integrator));
    lines.add("bands", bands);
    lines.add("gradients", nameOf(gradients));
    lines.add("spacing", spacing);
    lines.add("levels", levels);
    addRefine(lines, refine);
    addTarget(lines, target);
    addBounds(lines, bounds);
    lines.add("visibility", visibility);
    lines.add("part", part);
    lines.add("parts", parts);
    lines.add("light-group", lightGroup);
    return lines.text();
}

} // namespace lumivdb
