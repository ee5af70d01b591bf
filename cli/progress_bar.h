// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file progress_bar.h
/// Progress for people: a bar with the time left on a terminal, plain lines elsewhere.

#include <lumivdb/core/progress.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <mutex>
#include <string>

namespace lumivdb::cli {

enum class ProgressStyle {
    Silent, ///< --quiet; still cancels
    Lines, ///< a line when a stage starts, every tenth (not more than once a second) or 10 s, and
           ///< ends
    Bar ///< one line that is redrawn
};

/// Bar when stderr is a terminal, Lines otherwise.
ProgressStyle progressStyleOfStderr();

/// Talks to stderr; cancelled() follows interrupted(). Shows the share and the time left of the
/// whole work where that is known, else those of the stage.
class ProgressBar : public Progress {
public:
    using Warn = std::function<void(const std::string&)>;
    /// @a warn: who says warnings; one at a time, while the terminal's line is free.
    explicit ProgressBar(ProgressStyle style, Warn warn = nullptr);
    ~ProgressBar() override;
    void begin(const char* stage, std::uint64_t total) override;
    void advance(std::uint64_t steps) override;
    void expect(double seconds) override;
    bool wantsForecast() override { return mStyle != ProgressStyle::Silent; }
    void warn(const std::string& sentence) override;
    bool cancelled() override;
    /// Ends the stage that runs; the terminal's line is free again.
    void finish();

private:
    double elapsedSeconds() const;
    double fraction() const;
    /// Of the whole work; infinity where it is not known.
    double secondsLeft() const;
    std::string text(int barWidth) const;
    void drawBar();
    void endStage();
    bool dueForLine(double elapsed);

    const ProgressStyle mStyle;
    const Warn mWarn;
    std::mutex mMutex; // guards everything but mDone
    std::atomic<std::uint64_t> mDone{0};
    std::uint64_t mTotal = 0;
    std::string mStage; // empty: no stage runs
    std::chrono::steady_clock::time_point mStart;
    double mLastOutput = 0; // seconds after mStart
    double mLastFraction = 0;
    // Of the whole work.
    std::chrono::steady_clock::time_point mWholeStart = std::chrono::steady_clock::now();
    double mEnd = 0; // when it is thought to be done, seconds after mWholeStart; 0: nobody said
};

/// "  42% [########            ] 12 s, about 17 s left".
std::string progressText(double fraction, double elapsedSeconds, int barWidth);

} // namespace lumivdb::cli
