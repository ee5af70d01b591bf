// SPDX-License-Identifier: Apache-2.0
#include "interrupt.h"

#include <lumivdb/core/error.h>

#include <csignal>
#include <initializer_list>

#include <fcntl.h>
#include <unistd.h>

namespace lumivdb::cli {

namespace {

// A signal handler can reach nothing but globals; this is the program's only one.
volatile std::sig_atomic_t gInterrupted = 0;

void onSignal(int)
{
    if (gInterrupted) _exit(static_cast<int>(ErrorCode::Interrupted));
    gInterrupted = 1;
}

void handle(int signal, void (*handler)(int))
{
    struct sigaction action = {};
    action.sa_handler = handler;
    sigemptyset(&action.sa_mask);
    // No SA_RESTART: a read from a terminal or pipe must end when the user wants to stop.
    sigaction(signal, &action, nullptr);
}

bool ignoredByParent(int signal)
{
    struct sigaction action = {};
    return sigaction(signal, nullptr, &action) == 0 && action.sa_handler == SIG_IGN;
}

} // namespace

void installSignalHandlers()
{
    handle(SIGINT, onSignal);
    handle(SIGTERM, onSignal);
    if (!ignoredByParent(SIGHUP)) handle(SIGHUP, onSignal); // nohup stays nohup
    handle(SIGPIPE, SIG_IGN);
    handle(SIGXFSZ, SIG_IGN);
}

void occupyStandardStreams()
{
    for (const int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
        if (::fcntl(fd, F_GETFD) != -1) continue;
        // open() takes the lowest free number, which is fd. Reading from stdin, writing to the
        // others has to fail: hence the wrong direction for each.
        ::open("/dev/null", fd == STDIN_FILENO ? O_WRONLY : O_RDONLY);
    }
}

bool interrupted() { return gInterrupted != 0; }

void throwIfInterrupted()
{
    if (interrupted()) {
        throw Error(ErrorCode::Interrupted, "Interrupted: nothing was written; start it again.");
    }
}

} // namespace lumivdb::cli
