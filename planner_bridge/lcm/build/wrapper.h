#include <lcm/lcm.h>
