// A network that is there.
#pragma once

#include "Arduino.h"

static const int WL_CONNECTED = 3;

struct Network {
  void begin(const char *, const char *) {}
  int status() { return WL_CONNECTED; }
  void setSleep(bool) {}
};
inline Network WiFi;

struct IPAddress {
  IPAddress(uint8_t, uint8_t, uint8_t, uint8_t) {}
};
