// Lines of a line sensor over WiFi: JSON in UDP datagrams from an ESP32, 100 a second.
//
// Put in the name and password of the network, and the address of the computer with the agent.
// The settings that go with it:
//
//   [[device]]
//   sensor = "line_sensor"
//   unit = "esp-1"
//   name = "my_esp"
//   udp_port = 5005
//   format = "json"
//   columns = ["n", "t [us]", "emg/emg [V]"]
//   sequence_column = "n"
//   time_column = "t"
//   rate_hz = 100.0

#include <WiFi.h>
#include <WiFiUdp.h>

const char *NETWORK = "NAME";
const char *PASSWORD = "PASSWORD";
const IPAddress AGENT(192, 168, 1, 10);
const uint16_t AGENT_PORT = 5005;

const uint32_t PERIOD_US = 10000;
const int INPUT_PIN = 34;

WiFiUDP udp;
uint32_t count = 0;
uint32_t due = 0;

void setup() {
  WiFi.begin(NETWORK, PASSWORD);
  while (WiFi.status() != WL_CONNECTED) {
    delay(100);
  }
  // Without it the radio sleeps between beacons, and datagrams wait for up to 300 ms.
  WiFi.setSleep(false);
  due = micros();
}

void loop() {
  if ((int32_t)(micros() - due) < 0) {
    return;
  }
  due += PERIOD_US;

  uint32_t now = micros();
  float volts = analogReadMilliVolts(INPUT_PIN) / 1000.0;

  // A datagram that cannot be sent is missing in the count, so the agent knows of it.
  udp.beginPacket(AGENT, AGENT_PORT);
  udp.printf("{\"n\":%lu,\"t\":%lu,\"emg\":%.4f}\n", (unsigned long)count++,
             (unsigned long)now, volts);
  udp.endPacket();
}
