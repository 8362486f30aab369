/* model/position.h — H1 completes */
#ifndef MODEL_POSITION_H
#define MODEL_POSITION_H

enum position_mode { POSITION_OFF = 0, POSITION_ZERO_VELOCITY_AT_REST = 1 };

struct position_config {
	enum position_mode mode;
	double longest_integration_s; /* since the last rest; 0: no limit */
};
#endif
