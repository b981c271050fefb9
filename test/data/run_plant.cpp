/*
 * Do what the lines of the standard input say with a Plant of a library, and a log if there is one:
 * i INPUT VALUE, s STEPS, g READING (print it exactly), r LOG (start again).
 */
#include <exception>
#include <iostream>
#include <string>

#include "plant.hpp"

int main(int count, char ** arguments)
{
  try {
    timo_sim_hardware::Plant plant(arguments[1]);
    const std::string log = count > 2 ? arguments[2] : "";
    plant.start(log);
    std::cerr << plant.log_path();
    std::cout << std::hexfloat;
    for (std::string what, text; std::cin >> what >> text; ) {
      if (what == "i") {
        std::string value;
        std::cin >> value;
        plant.set(plant.input(text), std::stod(value));
      } else if (what == "s") {
        plant.step(std::stol(text));
      } else if (what == "g") {
        std::cout << plant.get(plant.reading(text)) << "\n";
      } else if (what == "r") {
        plant.start(text);
      }
    }
    std::cout << plant.time_step() << "\n";
  } catch (const std::exception & error) {
    std::cout << error.what() << "\n";
    return 1;
  }
}
