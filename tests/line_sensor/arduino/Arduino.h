// What the sketches of docs/sensors/line_sensor use of Arduino, for a computer: time runs by steps,
// Serial is standard output.
#pragma once

#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

static const int A0 = 14;
static const int A1 = 15;

inline uint32_t clock_us = 0;

inline uint32_t micros() { return clock_us; }
inline void delay(uint32_t ms) { clock_us += 1000 * ms; }
inline int analogRead(int pin) { return pin == A0 ? 512 : 256; }
inline uint32_t analogReadMilliVolts(int) { return 1650; }

struct SerialPort {
  void begin(unsigned long) {}
  void print(char text) { std::printf("%c", text); }
  void print(uint32_t number) { std::printf("%u", number); }
  void print(double number, int digits) { std::printf("%.*f", digits, number); }
  void println(double number, int digits) { std::printf("%.*f\r\n", digits, number); }
};
inline SerialPort Serial;
