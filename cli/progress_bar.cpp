// SPDX-License-Identifier: Apache-2.0
#include "progress_bar.h"

#include "interrupt.h"
#include "numbers.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>

#include <sys/ioctl.h>
#include <unistd.h>

namespace lumivdb::cli {

namespace {

constexpr double kRedrawSeconds = 0.1;
constexpr double kLineSeconds = 10;
constexpr double kLineFraction = 0.1;

int terminalColumns()
{
    struct winsize size = {};
    if (::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0) return size.ws_col;
    return 80;
}

void talk(const std::string& text)
{
    std::fputs(text.c_str(), stderr);
    std::fflush(stderr);
}

} // namespace

ProgressStyle progressStyleOfStderr()
{
    return ::isatty(STDERR_FILENO) ? ProgressStyle::Bar : ProgressStyle::Lines;
}

std::string progressText(double fraction, double elapsedSeconds, int barWidth)
{
    char percent[16];
    std::snprintf(percent, sizeof percent, "%3.0f%%", 100 * fraction);
    std::string text = percent;
    if (barWidth > 0) {
        const auto filled = static_cast<std::size_t>(fraction * barWidth);
        text += " [" + std::string(filled, '#');
        text += std::string(static_cast<std::size_t>(barWidth) - filled, ' ') + "]";
    }
    text += " " + humanSeconds(elapsedSeconds);
    // Early estimates are wild: none before 1% and half a second.
    if (fraction > 0.01 && fraction < 1 && elapsedSeconds > 0.5) {
        text += ", about " + humanSeconds(elapsedSeconds * (1 - fraction) / fraction) + " left";
    }
    return text;
}

namespace {

double secondsSince(std::chrono::steady_clock::time_point start)
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

} // namespace

ProgressBar::ProgressBar(ProgressStyle style, Warn warn)
    : mStyle(style)
    , mWarn(std::move(warn))
{
}

ProgressBar::~ProgressBar() { finish(); }

void ProgressBar::begin(const char* stage, std::uint64_t total)
{
    const std::lock_guard<std::mutex> lock(mMutex);
    endStage();
    mStage = stage;
    mTotal = total;
    mDone = 0;
    mLastOutput = mLastFraction = 0;
    mStart = std::chrono::steady_clock::now();
    if (mStyle == ProgressStyle::Bar) drawBar();
    if (mStyle == ProgressStyle::Lines) {
        talk(mStage + ": " + (total > 1 ? grouped(total) + " steps\n" : "started\n"));
    }
}

void ProgressBar::advance(std::uint64_t steps)
{
    mDone.fetch_add(steps, std::memory_order_relaxed);
    if (mStyle == ProgressStyle::Silent) return;
    // A thread that finds another one printing has nothing to add.
    const std::unique_lock<std::mutex> lock(mMutex, std::try_to_lock);
    if (!lock || mStage.empty()) return;
    const double elapsed = elapsedSeconds();
    if (mStyle == ProgressStyle::Bar) {
        if (elapsed - mLastOutput < kRedrawSeconds) return;
        mLastOutput = elapsed;
        drawBar();
    } else if (dueForLine(elapsed)) {
        talk(mStage + ": " + text(0) + "\n");
    }
}

void ProgressBar::expect(double seconds)
{
    const std::lock_guard<std::mutex> lock(mMutex);
    mEnd = secondsSince(mWholeStart) + seconds;
}

void ProgressBar::warn(const std::string& sentence)
{
    const std::lock_guard<std::mutex> lock(mMutex);
    if (mStyle == ProgressStyle::Bar) talk("\r\033[K");
    if (mWarn) mWarn(sentence);
}

bool ProgressBar::cancelled() { return interrupted(); }

void ProgressBar::finish()
{
    const std::lock_guard<std::mutex> lock(mMutex);
    endStage();
}

double ProgressBar::elapsedSeconds() const { return secondsSince(mStart); }

double ProgressBar::fraction() const
{
    if (mTotal == 0) return 0;
    const double done = static_cast<double>(mDone.load(std::memory_order_relaxed));
    return std::min(1.0, done / static_cast<double>(mTotal));
}

double ProgressBar::secondsLeft() const
{
    if (!(mEnd > 0)) return std::numeric_limits<double>::infinity();
    return std::max(0.0, mEnd - secondsSince(mWholeStart));
}

std::string ProgressBar::text(int barWidth) const
{
    const double left = secondsLeft(), whole = secondsSince(mWholeStart);
    if (std::isfinite(left))
        return progressText(whole / (whole + left), whole, barWidth) + " in all";
    const std::string stage = progressText(fraction(), elapsedSeconds(), barWidth);
    const bool tells = mEnd > 0 && stage.back() == 't';
    return stage + (tells ? " of this step" : "");
}

bool ProgressBar::dueForLine(double elapsed)
{
    const double since = elapsed - mLastOutput;
    const double now = fraction();
    const bool tenth = now - mLastFraction >= kLineFraction && since >= 1;
    if (now >= 1 || (!tenth && since < kLineSeconds)) return false;
    mLastOutput = elapsed;
    mLastFraction = now;
    return true;
}

void ProgressBar::drawBar()
{
    const int room = terminalColumns() - static_cast<int>(mStage.size()) - 58;
    const int width = std::clamp(room, 0, 30);
    talk("\r\033[K" + mStage + " " + text(width));
}

void ProgressBar::endStage()
{
    if (mStage.empty()) return;
    const double elapsed = elapsedSeconds();
    const bool whole = mDone.load() >= mTotal && !interrupted();
    if (mStyle == ProgressStyle::Bar) talk("\r\033[K");
    // On a terminal the bar was seen: only what took a while stays.
    const bool told
        = mStyle == ProgressStyle::Lines || (mStyle == ProgressStyle::Bar && elapsed > 1);
    if (whole && told) talk(mStage + ": done in " + humanSeconds(elapsed) + "\n");
    mStage.clear();
}

} // namespace lumivdb::cli
