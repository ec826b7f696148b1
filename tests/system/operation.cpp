// SPDX-License-Identifier: MIT
#include "tests/system/operation.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <sstream>

namespace eigencast::testing {

bool send_all(int fd, const std::string& bytes) {
  for (std::size_t sent = 0; sent < bytes.size();) {
    const ssize_t count = ::send(fd, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (count <= 0) return false;
    sent += static_cast<std::size_t>(count);
  }
  return true;
}

std::string websocket_text(const std::string& text) {
  // Masked by zeros, which leave it as it is.
  return std::string("\x81") + static_cast<char>(0x80 | text.size()) + std::string(4, '\0') + text;
}

int connect_to(const std::string& port, const char* from) {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in source{};
  source.sin_family = AF_INET;
  if (::inet_pton(AF_INET, from, &source.sin_addr) != 1 ||
      ::bind(fd, reinterpret_cast<const sockaddr*>(&source), sizeof source) != 0) {
    ::close(fd);
    return -1;
  }
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(port)));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const timeval patience{20, 0};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  if (::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    ::close(fd);
    return -1;
  }
  return fd;
}

int upgrade(const std::string& port, const std::string& target, const char* from) {
  const int fd = connect_to(port, from);
  std::string head;
  if (fd >= 0 && send_all(fd, "GET " + target +
                                  " HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                                  "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
                                  "Sec-WebSocket-Protocol: eigencast.v2\r\n\r\n")) {
    for (char c = 0; head.find("\r\n\r\n") == std::string::npos && ::recv(fd, &c, 1, 0) == 1;) head += c;
  }
  if (head.starts_with("HTTP/1.1 101")) return fd;
  if (fd >= 0) ::close(fd);
  return -1;
}

std::string ask(const std::string& port, const std::string& method, const std::string& target,
                const std::string& body) {
  const int fd = connect_to(port);
  if (fd < 0) return {};
  std::string answer;
  if (send_all(fd, method + " " + target + " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: " +
                       std::to_string(body.size()) + "\r\n\r\n" + body)) {
    char buffer[4096];
    for (ssize_t count = 0; (count = ::recv(fd, buffer, sizeof buffer, 0)) > 0;) {
      answer.append(buffer, static_cast<std::size_t>(count));
    }
  }
  ::close(fd);
  return answer;
}

std::string body_of(const std::string& answer) {
  const auto end = answer.find("\r\n\r\n");
  return end == std::string::npos ? std::string() : answer.substr(end + 4);
}

nlohmann::json Operation::api(const std::string& name) {
  return nlohmann::json::parse(body_of(get("/api/" + name)), nullptr, false);
}

nlohmann::json Operation::client_of_kind(const std::string& kind) {
  const nlohmann::json report = api("clients");
  for (const auto& client : report["clients"]) {
    if (client["kind"] == kind) return client;
  }
  return {};
}

double Operation::metric(const std::string& name) {
  std::istringstream text(body_of(get("/metrics")));
  for (std::string line; std::getline(text, line);) {
    if (line.rfind(name + " ", 0) == 0) return std::stod(line.substr(name.size() + 1));
  }
  ADD_FAILURE() << "no metric " << name;
  return -1;
}

bool Operation::live() {
  const auto keys = [this] {
    const auto streams = api("streams");
    const bool any = streams.contains("streams") && !streams["streams"].empty();
    return any ? streams["streams"][0]["keys_received"].get<std::uint64_t>() : 0;
  };
  const std::uint64_t before = keys();
  return eventually([&] { return keys() >= before + 10; }, kPatience);
}

bool Operation::grows(const std::string& name) {
  const std::size_t before = scene_.received(name).size();
  return eventually([&] { return scene_.received(name).size() >= before + 10; }, kPatience);
}

void Operation::kill(Process& process) {
  process.signal(SIGKILL);
  ASSERT_EQ(process.wait(kPatience), 128 + SIGKILL);
}

std::vector<std::string> Operation::recordings() const {
  std::vector<std::string> found;
  for (const auto& entry : std::filesystem::directory_iterator(scene_.file("assets") + "/recordings")) {
    found.push_back(entry.path().string());
  }
  return found;
}

}  // namespace eigencast::testing
