// SPDX-License-Identifier: GPL-3.0-or-later
// Receives focal points from the array server on this machine and passes them to Ultraleap's SDK.
//
// Its only argument is the session number to accept. It prints "ready PORT LIMIT" to standard
// output once the array is connected. It silences the array and exits when standard input ends, on
// a signal, or when the array is gone. The array has no watchdog, so the bridge acts as one: it is
// silent after 150 ms without focal points.
//
// CMakeLists.txt explains how to build it with your own copy of the SDK.

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <thread>

#ifdef _WIN32
#include <winsock2.h>
#include <ws2tcpip.h>
using socket_t = SOCKET;
#else
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>
using socket_t = int;
#endif

#include "array.hpp"

namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds stale_after{150};
constexpr milliseconds min_interval{10};  // the SDK's limit between two updates
constexpr int max_wait = 5;               // ms

std::atomic<bool> ending{false};

void end_on_signal(int) { ending = true; }

socket_t listen_on_loopback(unsigned short &port) {
#ifdef _WIN32
    WSADATA data;
    if (WSAStartup(MAKEWORD(2, 2), &data) != 0) throw tactile_clay::ArrayError("no network");
#endif
    const socket_t handle = socket(AF_INET, SOCK_DGRAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    if (bind(handle, reinterpret_cast<sockaddr *>(&address), size) != 0 ||
        getsockname(handle, reinterpret_cast<sockaddr *>(&address), &size) != 0)
        throw tactile_clay::ArrayError("no free port");
    port = ntohs(address.sin_port);
#ifdef _WIN32
    const DWORD wait = max_wait;
#else
    const timeval wait{0, max_wait * 1000};
#endif
    setsockopt(handle, SOL_SOCKET, SO_RCVTIMEO, reinterpret_cast<const char *>(&wait), sizeof(wait));
    return handle;
}

void serve(tactile_clay::Array &array, socket_t handle, std::uint32_t session) {
    static unsigned char data[65536];
    std::optional<tactile_clay::FociMessage> newest;
    std::uint64_t sequence = 0;
    bool waiting = false, emitting = false;
    Clock::time_point heard = Clock::now(), updated = heard - min_interval;
    while (!ending) {
        const auto size = recv(handle, reinterpret_cast<char *>(data), sizeof(data), 0);
        const auto now = Clock::now();
        if (size > 0) {
            auto read = tactile_clay::read_focal_points(data, static_cast<std::size_t>(size),
                                                        array.limit());
            if (read && read->session == session && read->sequence > sequence) {
                sequence = read->sequence;
                newest = std::move(read);
                waiting = true;
                heard = now;
            }
        }
        if (emitting && (now - heard > stale_after || (newest && newest->points.empty()))) {
            array.stop();
            emitting = waiting = false;
        }
        if (waiting && now - updated >= min_interval && now - heard <= stale_after) {
            waiting = false;
            updated = now;
            if (!newest->points.empty()) {
                emitting = true;
                array.emit(*newest);
            }
        }
        if (!array.connected()) throw tactile_clay::ArrayError("the array is gone");
    }
}

}  // namespace

int main(int count, char **words) {
    const auto session = static_cast<std::uint32_t>(count > 1 ? std::strtoul(words[1], nullptr, 10) : 0);
    std::signal(SIGINT, end_on_signal);
    std::signal(SIGTERM, end_on_signal);
    std::thread([] {
        while (std::getchar() != EOF) {
        }
        ending = true;
    }).detach();
    try {
        auto array = tactile_clay::connect_array();
        unsigned short port = 0;
        const socket_t handle = listen_on_loopback(port);
        std::printf("ready %u %zu\n", static_cast<unsigned>(port), array->limit());
        std::fflush(stdout);
        try {
            serve(*array, handle, session);
        } catch (...) {
            try {
                array->stop();
            } catch (const std::exception &) {
                // An array that is gone cannot be stopped; report the first error.
            }
            throw;
        }
        array->stop();
    } catch (const std::exception &error) {
        std::printf("failed %s\n", error.what());
        std::fflush(stdout);
        // Returning from main would wait for the thread that reads standard input.
        std::_Exit(1);
    }
    std::_Exit(0);
}
