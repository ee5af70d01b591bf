// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file gnuplot.h
/// Pictures by the gnuplot program, which is looked for when it is needed.

#include <string>

namespace lumivdb::cli {

/// Before long work: whether @a path names a format that can be plotted (.png, .svg) and gnuplot is
/// there. @throws Error(Usage), Error(Output).
void checkPlot(const std::string& path, const std::string& option);

/// Runs @a script, which must neither choose a terminal nor an output, and writes the picture of
/// @a width × @a height pixels to @a path. No shell takes part, and no file name. @throws
/// Error(Output) with what gnuplot says.
void plot(const std::string& path, const std::string& script, int width, int height);

/// @a text as a string of a script, whatever is in it.
std::string plotText(const std::string& text);

} // namespace lumivdb::cli
