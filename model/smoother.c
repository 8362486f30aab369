#include "model/smoother.h"

#include <string.h>

enum {
	N = NAVIGATION_STATES,
	ROWS = SMOOTHER_ROWS,
	FIRST_ROW = NAVIGATION_V,
	POSITION = NAVIGATION_P - NAVIGATION_V,
	BLOCK = 12
};

static bool recording(const struct smoother *s)
{
	return s && s->recording;
}

/* ---- the map from the last point to now ---- */

static void set_identity(struct smoother_map *map)
{
	memset(map, 0, sizeof(*map));
	for (int i = 0; i < N; i++)
		map->a[i][i] = 1;
}

double (*smoother_transition(struct smoother *s))[N]
{
	return recording(s) ? s->recent.a : NULL;
}

void smoother_measure(
	struct smoother *s, const double row[N], const double p_row[N], double innovation, double variance)
{
	struct smoother_map *map;
	double g[N] = {0};

	if (!recording(s))
		return;
	map = &s->recent;
	for (int i = 0; i < N; i++) {
		if (row[i] == 0)
			continue;
		for (int j = 0; j < N; j++)
			g[j] += row[i] * map->a[i][j];
	}
	for (int i = 0; i < N; i++) {
		double gain = p_row[i] / variance, share = g[i] / variance;

		map->b[i] -= share * innovation;
		for (int j = 0; j < N; j++) {
			map->m[i][j] += share * g[j];
			map->a[i][j] -= gain * g[j];
		}
	}
}

void smoother_reset_errors(struct smoother *s, int at)
{
	if (!recording(s))
		return;
	memset(s->recent.a[at], 0, 3 * sizeof(s->recent.a[at]));
	s->whole = false;
}

/* ---- points ---- */

static void add3(struct vec3 *a, const double d[3])
{
	*a = vec3_add(*a, (struct vec3){d[0], d[1], d[2]});
}

/* One point by the map; a_transposed is its A^T. */
static void correct_point(struct smoother_kept *k, const struct smoother_map *map, double a_transposed[N][N])
{
	double by[ROWS] = {0}, x[ROWS][N] = {{0}};

	for (int r = 0; r < ROWS; r++)
		for (int j = 0; j < N; j++) {
			by[r] -= k->x[r][j] * map->b[j];
			for (int i = 0; i < N; i++)
				x[r][i] += k->x[r][j] * a_transposed[j][i];
		}
	for (int r = 0; r < 3; r++) {
		double xm[N] = {0};

		for (int j = 0; j < N; j++)
			for (int i = 0; i < N; i++)
				xm[i] += k->x[POSITION + r][j] * map->m[j][i];
		for (int i = 0; i < N; i++)
			k->variance[r] -= xm[i] * k->x[POSITION + r][i];
	}
	add3(&k->point.velocity_n_m_s, by);
	add3(&k->point.position_n_m, by + POSITION);
	memcpy(k->x, x, sizeof(x));
}

static void correct_points(struct smoother_kept *from, const struct smoother_kept *end, const struct smoother_map *map)
{
	double a_transposed[N][N];

	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			a_transposed[j][i] = map->a[i][j];
	for (; from < end; from++)
		correct_point(from, map, a_transposed);
}

/* The map `map` followed by `next`, into `map`. */
static void append(struct smoother_map *map, const struct smoother_map *next)
{
	const struct smoother_map first = *map;
	double ma[N][N] = {{0}};

	memset(map->a, 0, sizeof(map->a));
	for (int i = 0; i < N; i++)
		for (int k = 0; k < N; k++)
			for (int j = 0; j < N; j++) {
				map->a[i][j] += next->a[i][k] * first.a[k][j];
				ma[i][j] += next->m[i][k] * first.a[k][j];
			}
	for (int k = 0; k < N; k++)
		for (int i = 0; i < N; i++) {
			map->b[i] += first.a[k][i] * next->b[k];
			for (int j = 0; j < N; j++)
				map->m[i][j] += first.a[k][i] * ma[k][j];
		}
}

/* The measurements since the last point correct the latest points at once. Older points wait until there is a block of
 * new ones, which costs a fifth of correcting them each time. */
static void correct(struct smoother *s, bool all)
{
	correct_points(s->kept + s->settled, s->kept + s->count, &s->recent);
	append(&s->earlier, &s->recent);
	set_identity(&s->recent);
	if (!all && s->count - s->settled < BLOCK)
		return;
	correct_points(s->kept, s->kept + s->settled, &s->earlier);
	set_identity(&s->earlier);
	s->settled = s->count;
}

static void thin_out(struct smoother *s)
{
	s->count = (s->count + 1) / 2;
	for (size_t k = 1; k < s->count; k++)
		s->kept[k] = s->kept[2 * k];
	s->settled = s->count;
	s->spacing_s *= 2;
}

static bool due(const struct smoother *s)
{
	return s->t_s - s->kept[s->count - 1].point.t_s > 0.99 * s->spacing_s;
}

static void keep(struct smoother *s, double t_s, struct smoother_point here, double p[N][N])
{
	struct smoother_kept *k = &s->kept[s->count++];

	k->point = here;
	k->point.t_s = t_s;
	k->point.position_n_m = vec3_sub(here.position_n_m, s->from_n_m);
	k->live = s->live;
	k->live.t_s = t_s;
	for (int r = 0; r < 3; r++)
		k->variance[r] = p[NAVIGATION_P + r][NAVIGATION_P + r];
	memcpy(k->x, p[FIRST_ROW], sizeof(k->x));
}

/* The live path has no steps where the filter's corrections have. */
static void integrate_live(struct smoother *s, struct vec3 velocity)
{
	double dt = s->t_s - s->live.t_s;
	struct vec3 step = vec3_scale(dt / 2, vec3_add(s->live.velocity_n_m_s, velocity));

	s->live.position_n_m = vec3_add(s->live.position_n_m, step);
	s->live.velocity_n_m_s = velocity;
	s->live.t_s = s->t_s;
	s->live_m += vec3_norm(step);
}

void smoother_mark(struct smoother *s, struct smoother_point here, double p[N][N])
{
	if (!recording(s))
		return;
	integrate_live(s, here.velocity_n_m_s);
	s->here = here;
	if (!due(s))
		return;
	correct(s, s->count == SMOOTHER_POINTS - 1);
	if (s->count == SMOOTHER_POINTS - 1) /* dropping every second of an odd number keeps the first and the last */
		thin_out(s);
	if (due(s))
		keep(s, s->t_s, here, p);
}

void smoother_elapse(struct smoother *s, double dt_s)
{
	if (recording(s))
		s->t_s += dt_s;
}

/* ---- movements ---- */

static void start(struct smoother *s, struct smoother_point here, double p[N][N])
{
	s->t_s = 0;
	s->spacing_s = SMOOTHER_SPACING_S;
	s->count = s->settled = 0;
	s->here = here;
	s->from_n_m = here.position_n_m;
	s->live = (struct smoother_point){.velocity_n_m_s = here.velocity_n_m_s};
	s->live_m = 0;
	set_identity(&s->recent);
	keep(s, 0, here, p);
	memset(s->kept[0].variance, 0, sizeof(s->kept[0].variance));
	memset(s->kept[0].x[POSITION], 0, 3 * sizeof(s->kept[0].x[POSITION]));
}

void smoother_begin(struct smoother *s, struct smoother_point here, double p[N][N])
{
	if (!s)
		return;
	s->recording = s->whole = true;
	start(s, here, p);
}

void smoother_restart(struct smoother *s, struct smoother_point here, double p[N][N])
{
	if (!recording(s))
		return;
	s->whole = false;
	start(s, here, p);
}

/* Length of the path between two points, by Simpson's rule along the cubic through them that has their velocities. */
static double length(const struct smoother_point *a, const struct smoother_point *b)
{
	double dt = b->t_s - a->t_s;
	struct vec3 chord = vec3_sub(b->position_n_m, a->position_n_m), middle;

	if (dt <= 0)
		return 0;
	middle =
		vec3_sub(vec3_scale(1.5 / dt, chord), vec3_scale(0.25, vec3_add(a->velocity_n_m_s, b->velocity_n_m_s)));

	return dt / 6 * (vec3_norm(a->velocity_n_m_s) + 4 * vec3_norm(middle) + vec3_norm(b->velocity_n_m_s));
}

static double root(double variance)
{
	return sqrt(fmax(variance, 0));
}

static void publish(struct smoother *s, double stood_s)
{
	struct smoother_movement *m = &s->last;
	double live_m = 0;

	*m = (struct smoother_movement){.number = m->number + 1,
		.whole = s->whole,
		.duration_s = s->kept[s->count - 1].point.t_s,
		.stood_s = stood_s,
		.count = s->count};
	for (size_t k = 0; k < s->count; k++) {
		const double *variance = s->kept[k].variance;
		struct smoother_point *point = &m->point[k];
		double distance = vec3_norm(s->kept[k].point.position_n_m);

		*point = s->kept[k].point;
		point->sigma_m = (struct vec3){root(variance[0]), root(variance[1]), root(variance[2])};
		if (k > 0) {
			m->path_m += length(point - 1, point);
			live_m += length(&s->kept[k - 1].live, &s->kept[k].live);
		}
		if (distance > m->farthest_m) {
			m->farthest_m = distance;
			m->farthest_s = point->t_s;
		}
	}
	if (live_m > 0) /* the part of the path that lies between the points */
		m->path_m *= s->live_m / live_m;
}

void smoother_end(struct smoother *s, double stood_s, double p[N][N])
{
	double t_s;

	if (!recording(s))
		return;
	t_s = fmax(s->t_s - stood_s, 0);
	correct(s, true);
	while (s->count > 1 && s->kept[s->count - 1].point.t_s >= t_s)
		s->count--;
	keep(s, t_s, s->here, p);
	publish(s, stood_s);
	s->recording = false;
}

void smoother_break(struct smoother *s)
{
	if (recording(s))
		s->whole = false;
}

void smoother_cancel(struct smoother *s)
{
	if (s)
		s->recording = false;
}
