/* model/math/units.h
 * Units and physical constants, once for all. The model computes in SI units and radians; what people, chips and
 * objects use is converted by these factors: value_rad = value_deg * RAD_PER_DEG. */
#ifndef MODEL_MATH_UNITS_H
#define MODEL_MATH_UNITS_H

#define PI	    3.14159265358979323846
#define RAD_PER_DEG (PI / 180)
#define DEG_PER_RAD (180 / PI)

/** Standard gravity (CGPM 1901): the unit g of accelerometers. Local gravity is object 2003h. */
#define STANDARD_GRAVITY_M_S2 9.80665
#define M_S2_PER_MG	      (1e-3 * STANDARD_GRAVITY_M_S2)

/** 1 gauss = 100 microtesla. */
#define UT_PER_GAUSS 100.0

#endif
