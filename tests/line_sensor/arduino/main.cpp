// Runs a sketch for some looks; its clock begins a tenth of a second before it turns over.
#include "Arduino.h"

#include SKETCH

int main(int, char **arguments) {
  clock_us = 0u - 100000u;
  setup();
  for (long step = 0; step < std::atol(arguments[1]) * 100; ++step) {
    loop();
    clock_us += 100;
  }
  return 0;
}
