// Sends datagrams to the port of loopback that the environment names.
#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include "WiFi.h"

class WiFiUDP {
 public:
  void beginPacket(const IPAddress &, uint16_t) { size_ = 0; }
  void printf(const char *form, ...) {
    va_list values;
    va_start(values, form);
    size_ += std::vsnprintf(packet_ + size_, sizeof packet_ - size_, form, values);
    va_end(values);
  }
  void endPacket() {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<uint16_t>(std::atoi(std::getenv("AGENT_PORT"))));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    sendto(socket_, packet_, size_, 0, reinterpret_cast<sockaddr *>(&to), sizeof to);
  }

 private:
  int socket_ = socket(AF_INET, SOCK_DGRAM, 0);
  char packet_[512];
  int size_ = 0;
};
