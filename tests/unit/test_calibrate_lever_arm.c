/* imu9-calibrate lever-arm as a program: from a log to three lines of a configuration file. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "gateway/config.h"
#include "model/sim/sensor.h"
#include "od_values.h"
#include "tests/unit/model_test.h"
#include "tools/calibrate/calibrate_lever_arm.h"

enum { ARGUMENTS_MAX = 8, TEXT_MAX = 4096 };

static char log_path[] = "/tmp/imu9_lever_log_XXXXXX", config_path[] = "/tmp/imu9_lever_ini_XXXXXX";

/* A log of a sensor at 50, -100, 200 mm from a reference point that moves; its acceleration is in columns of the
 * log. */
static int write_logs(void **state)
{
	struct sensor_config config = *sensor_preset("ideal");
	struct sensor sensor;
	FILE *log = fdopen(mkstemp(log_path), "w");
	int fd = mkstemp(config_path);

	(void)state;
	assert_non_null(log);
	assert_true(fd >= 0);
	close(fd);
	config.lever_arm_b_m = (struct vec3){0.05, -0.1, 0.2};
	assert_int_equal(sensor_init(&sensor, &config, 1), 0);
	fputs("t,gx,gy,gz,ax,ay,az,ref_al,ref_as,ref_at\n", log);
	for (int k = 0; k < 3200; k++) {
		struct signal_truth truth;
		struct imu_sample s;
		struct vec3 ref;

		signal_at(signal_find("tumble"), sensor_instant_s(&sensor), &truth);
		truth.accel_n_m_s2 = (struct vec3){3 * sin(5 * truth.t_s), 2 * cos(4 * truth.t_s), sin(6 * truth.t_s)};
		sensor_measure(&sensor, &truth, &s);
		ref = quat_rotate_inverse(truth.q_nb, truth.accel_n_m_s2);
		fprintf(log, "%.6f,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g\n", (double)s.t_us * 1e-6,
			s.gyro_rad_s.x, s.gyro_rad_s.y, s.gyro_rad_s.z, s.accel_m_s2.x, s.accel_m_s2.y, s.accel_m_s2.z,
			ref.x, ref.y, ref.z);
	}
	return fclose(log);
}

static int remove_logs(void **state)
{
	(void)state;
	unlink(log_path);
	unlink(config_path);
	return 0;
}

/* Runs the subcommand in a child process. Returns its exit status, and its output in text. */
static int run(char text[TEXT_MAX], const char *a, const char *b, const char *c)
{
	char *argv[ARGUMENTS_MAX] = {(char *)"lever-arm", (char *)a, (char *)b, (char *)c};
	int argc = c ? 4 : b ? 3 : a ? 2 : 1, pipes[2], status = -1;
	size_t used = 0;
	ssize_t got;

	assert_int_equal(pipe(pipes), 0);
	pid_t child = fork();
	assert_true(child >= 0);
	if (child == 0) {
		dup2(pipes[1], STDOUT_FILENO);
		dup2(pipes[1], STDERR_FILENO);
		close(pipes[0]);
		status = calibrate_lever_arm(argc, argv);
		fflush(NULL);
		_exit(status);
	}
	close(pipes[1]);
	while ((got = read(pipes[0], text + used, TEXT_MAX - 1 - used)) > 0)
		used += (size_t)got;
	text[used] = '\0';
	close(pipes[0]);
	waitpid(child, &status, 0);
	assert_true(WIFEXITED(status));
	return WEXITSTATUS(status);
}

static void assert_contains(const char *text, const char *words)
{
	if (!strstr(text, words))
		fail_msg("'%s' is not in the output '%s'", words, text);
}

static void test_the_last_lines_are_a_valid_configuration_file(void **state)
{
	static struct od_values values;
	static struct config config;
	char text[TEXT_MAX], why[CONFIG_ERROR_MAX];
	struct od od;
	FILE *file = fopen(config_path, "w");

	(void)state;
	assert_int_equal(run(text, log_path, NULL, NULL), 0);
	assert_non_null(file);
	assert_contains(text, "[lever_arm]");
	fputs(strstr(text, "[lever_arm]"), file);
	fclose(file);
	config_init(&config, &imu9_od_table);
	if (config_file(&config, config_path, why) < 0)
		fail_msg("%s", why);
	od_init(&od, &imu9_od_table, &values, 1);
	config_apply(&config, &od);
	assert_near((double)values.lever_arm.l, 0.05, 0.001);
	assert_near((double)values.lever_arm.s, -0.1, 0.001);
	assert_near((double)values.lever_arm.t, 0.2, 0.001);
}

static void test_a_reference_in_sensor_axes_instead_of_the_object_frame_does_not_fit(void **state)
{
	char text[TEXT_MAX];

	(void)state;
	/* with a mounting, columns in sensor axes are wrong */
	assert_int_equal(run(text, "--set", "mounting.yaw=90", log_path), 1);
	assert_contains(text, "does not fit");
}

static void test_wrong_usage_exits_with_2_and_an_unreadable_file_with_1(void **state)
{
	char text[TEXT_MAX];

	(void)state;
	assert_int_equal(run(text, "--estimate-delay", NULL, NULL), 2); /* without a log: on the bus */
	assert_contains(text, "need a log");
	assert_int_equal(run(text, log_path, log_path, NULL), 2);
	assert_contains(text, "give one log");
	assert_int_equal(run(text, "--nonsense", log_path, NULL), 2);
	assert_int_equal(run(text, "--set", "lever_arm.q=1", log_path), 2);
	assert_int_equal(run(text, "/nowhere.csv", NULL, NULL), 1);
	assert_contains(text, "/nowhere.csv: No such file");
	assert_int_equal(run(text, "--reference", "/nowhere.csv", log_path), 1);
	assert_contains(text, "/nowhere.csv: No such file");
	assert_int_equal(run(text, "--help", NULL, NULL), 0);
	assert_contains(text, "Usage: imu9-calibrate lever-arm");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_last_lines_are_a_valid_configuration_file),
		cmocka_unit_test(test_a_reference_in_sensor_axes_instead_of_the_object_frame_does_not_fit),
		cmocka_unit_test(test_wrong_usage_exits_with_2_and_an_unreadable_file_with_1),
	};

	return cmocka_run_group_tests(tests, write_logs, remove_logs);
}
