#include "gateway/last_movement.h"
#include "od_index.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

static const char HEADER[] = "t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,sx_m,sy_m,sz_m\n";

/* Limits of the printed numbers, so that all lines fit. */
static const double TIME_MAX_S = 99999999, VALUE_MAX = 99999;
enum { LINE_MAX_BYTES = sizeof("99999999.999") + 9 * sizeof("-99999.0000") };
static_assert(sizeof(HEADER) + SMOOTHER_POINTS * LINE_MAX_BYTES <= OD_DOMAIN_MAX, "all points fit into the object");

static double limited(double value, double limit)
{
	return fmin(fmax(value, -limit), limit);
}

static int print_vec3(char *line, size_t size, struct vec3 v)
{
	return snprintf(line, size, ",%.4f,%.4f,%.4f", limited(v.x, VALUE_MAX), limited(v.y, VALUE_MAX),
		limited(v.z, VALUE_MAX));
}

static size_t print_point(char line[LINE_MAX_BYTES + 1], const struct smoother_point *p)
{
	const struct vec3 vectors[] = {p->position_n_m, p->velocity_n_m_s, p->sigma_m};
	const size_t size = LINE_MAX_BYTES + 1;
	int used = snprintf(line, size, "%.3f", limited(p->t_s, TIME_MAX_S));

	for (int i = 0; i < 3; i++)
		used += print_vec3(line + used, size - (size_t)used, vectors[i]);
	line[used] = '\n';
	return (size_t)used + 1;
}

/* A transfer reads the movement that was the last one at its beginning. */
static size_t read_trajectory(void *ctx, uint8_t *out)
{
	const struct smoother_movement *m = &((const struct last_movement *)ctx)->smoother.last;
	size_t used = sizeof(HEADER) - 1;

	memcpy(out, HEADER, used);
	for (size_t i = 0; i < m->count; i++) {
		char line[LINE_MAX_BYTES + 1];
		size_t size = print_point(line, &m->point[i]);

		memcpy(out + used, line, size);
		used += size;
	}
	return used;
}

void last_movement_attach(struct last_movement *m, struct od *od, struct od_values *values)
{
	m->values = values;
	m->domain = (struct od_domain){.index = OD_INDEX_TRAJECTORY, .read = read_trajectory, .ctx = m};
	od_set_domain(od, &m->domain);
}

void last_movement_start(struct last_movement *m, struct pipeline *pipeline)
{
	memset(&m->smoother, 0, sizeof(m->smoother));
	pipeline_smooth(pipeline, &m->smoother);
}

void last_movement_publish(struct last_movement *m)
{
	const struct smoother_movement *last = &m->smoother.last;
	const struct smoother_point *end;

	if (last->number == m->values->last_movement.number)
		return;
	end = &last->point[last->count - 1];
	m->values->last_movement.number = last->number;
	m->values->last_movement.duration = (float)last->duration_s;
	m->values->last_movement.path = (float)last->path_m;
	m->values->last_movement.farthest = (float)last->farthest_m;
	m->values->last_movement.farthest_time = (float)last->farthest_s;
	m->values->last_movement.x = (float)end->position_n_m.x;
	m->values->last_movement.y = (float)end->position_n_m.y;
	m->values->last_movement.z = (float)end->position_n_m.z;
	m->values->last_movement.sigma_x = (float)end->sigma_m.x;
	m->values->last_movement.sigma_y = (float)end->sigma_m.y;
	m->values->last_movement.sigma_z = (float)end->sigma_m.z;
	m->values->last_movement.points = (uint8_t)last->count;
	m->values->last_movement.whole = last->whole;
}
