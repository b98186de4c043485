// Lines of a line sensor over USB: count, time, and two analog inputs in volts, 100 a second.
//
// Any Arduino with a serial port. The settings that go with it:
//
//   [[device]]
//   sensor = "line_sensor"
//   unit = "uno-1"
//   name = "my_board"
//   port = "COM5"
//   columns = ["n", "t [us]", "emg/emg [V]", "force/force [V]"]
//   sequence_column = "n"
//   time_column = "t"
//   rate_hz = 100.0

const uint32_t PERIOD_US = 10000;
const float VOLTS_PER_STEP = 5.0 / 1023;  // 3.3 / 4095 on boards of 3.3 V and 12 bits

uint32_t count = 0;
uint32_t due = 0;

void setup() {
  Serial.begin(115200);
  due = micros();
}

void loop() {
  // The difference also holds when micros() turns over, after 71 minutes.
  if ((int32_t)(micros() - due) < 0) {
    return;
  }
  due += PERIOD_US;

  // First the time, then the values, then the line: the time is that of measuring.
  uint32_t now = micros();
  float emg = analogRead(A0) * VOLTS_PER_STEP;
  float force = analogRead(A1) * VOLTS_PER_STEP;

  Serial.print(count++);
  Serial.print(',');
  Serial.print(now);
  Serial.print(',');
  Serial.print(emg, 4);
  Serial.print(',');
  Serial.println(force, 4);
}
