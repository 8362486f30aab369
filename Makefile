# IMU9 CANopen gateway. `make help` lists the targets.
#
#   CC=clang        another compiler            BUILD=DIR       where everything is built (default build)
#   CC=aarch64-linux-gnu-gcc: cross build       CC_FOR_BUILD    the compiler for what runs while building
#   DEPS=no         do not install packages     SAN=FLAGS       e.g. -fsanitize=thread
#   WERROR=yes      a warning is an error (for developers and CI), but for what a newer library calls deprecated
#   PREFIX, DESTDIR where `make install` puts things

VERSION := 0.3.0
BUILD ?= build
PREFIX ?= /usr/local
DEPS ?= yes
WERROR ?= no
FUZZ_SECONDS ?= 30
SOAK_DAYS ?= 7
COUNT ?= 40
SEED ?= 1
LAYERS ?= model,od,canopen
JOBS ?= 1
SAN ?=

# A cross compiler PREFIX-gcc brings PREFIX-ar and PREFIX-pkg-config, and its tests run in qemu. The generator is for
# the machine that builds.
CROSS := $(if $(findstring -gcc,$(lastword $(CC))),$(firstword $(subst -gcc,- ,$(lastword $(CC)))))
CC_FOR_BUILD ?= $(if $(CROSS),gcc,$(CC))
AR := $(CROSS)ar
PKG_CONFIG ?= $(CROSS)pkg-config
EMULATOR ?= $(if $(CROSS),qemu-$(firstword $(subst -, ,$(notdir $(CROSS)))))
# the two APIs of libgpiod, 1 and 2, have a file each
GPIOD_API := $(or $(shell $(PKG_CONFIG) --modversion libgpiod 2>/dev/null | cut -d. -f1),-missing)

CFLAGS ?= -O2 -g
# enumeration constants are used as the whole numbers that they are, of which clang 20 warns
WARNINGS := -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wstrict-prototypes -Wmissing-prototypes \
	-Wno-enum-float-conversion -Wno-enum-enum-conversion \
	$(if $(filter yes,$(WERROR)),-Werror -Wno-error=deprecated-declarations)
# -ffp-contract=off: the same bits from gcc and clang, with and without fused multiply-add
# -ffile-prefix-map: the same bytes wherever it is built
ALL_CFLAGS = -std=c11 -D_GNU_SOURCE -DIMU9_VERSION='"$(VERSION)"' -I. -I$(BUILD)/gen $(WARNINGS) -ffp-contract=off \
	-ffile-prefix-map=$(BUILD)=build -ffile-prefix-map=$(CURDIR)=. -MMD -MP $(CFLAGS) $(SAN)
LDLIBS := -Wl,--as-needed -linih -lmpack -lmodbus -lgpiod -ljson-c -lncursesw -lm -pthread

# ---- what is built from what ---------------------------------------------------------------------------------------
sources = $(sort $(wildcard $(1)))
objects = $(patsubst %.c,$(BUILD)/obj/%.o,$(1))
GEN := $(addprefix $(BUILD)/gen/,od_index.h od_values.h od_table.c objects.md imu9-gateway.dbc \
	modbus_map.c modbus.md modbus.csv modbus-telegraf.conf modbus-node-red.json)

MODEL_SRC := $(call sources,model/*.c model/*/*.c)
OD_SRC := $(call sources,od/*.c)
DRIVERS_SRC := $(call sources,drivers/can/*.c drivers/i2c/*.c drivers/imu/*.c drivers/imu/*/*.c)
DRIVERS_SRC := $(filter-out drivers/imu/pololu/drdy_gpiod%,$(DRIVERS_SRC)) drivers/imu/pololu/drdy_gpiod$(GPIOD_API).c
CANOPEN_SRC := $(call sources,gateway/canopen/*.c gateway/canopen/client/*.c)
MODBUS_SRC := $(call sources,gateway/modbus/*.c)
GATEWAY_SRC := $(filter-out gateway/main.c,$(call sources,gateway/*.c gateway/cia309/*.c))
# imu9-web is for the machine that builds: Debian's libwebsockets-dev cannot be installed for a second architecture
NOT_CROSS := $(if $(CROSS),tools/web/imu9_web.c tools/web/server.c)
PROGRAM_SRC := $(filter-out $(NOT_CROSS),$(call sources,tools/*/imu9_*.c))
FLEET_SRC := $(filter-out $(PROGRAM_SRC),$(call sources,tools/fleet/*.c))
TOOLS_SRC := $(filter-out tools/eds/gen_od.c $(PROGRAM_SRC) $(FLEET_SRC) $(NOT_CROSS),$(call sources,tools/*/*.c))

MODEL_LIB := $(BUILD)/libmodel.a
LIBS := $(patsubst %,$(BUILD)/lib%.a,tools gateway modbus_server canopen drivers od) $(MODEL_LIB)
TOOLS := $(addprefix $(BUILD)/,$(subst _,-,$(basename $(notdir $(PROGRAM_SRC)))))
PROGRAMS := $(BUILD)/imu9-gateway $(TOOLS)
TESTS := $(patsubst %.c,$(BUILD)/%,$(call sources,tests/unit/test_*.c tests/scenario/test_*.c \
	tests/interop/test_*.c))
BENCHES := $(patsubst %.c,$(BUILD)/%,$(call sources,tests/bench/bench_*.c))
FUZZERS := $(patsubst %.c,$(BUILD)/%,$(call sources,tests/fuzz/fuzz_*.c))
SOAKS := $(patsubst %.c,$(BUILD)/%,$(call sources,tests/soak/*.c))
SOAK := $(BUILD)/tests/soak/soak_device
PLANT := $(BUILD)/tests/plant/nodes
RIG_PROGRAMS := $(patsubst %.c,$(BUILD)/%,$(filter-out tests/rig/uml_xstate.c,$(call sources,tests/rig/*.c)))
# what the tests of one folder share: its .c files that are no program of their own
helpers = $(call objects,$(filter-out $(1)/test_% $(1)/bench_% $(1)/fuzz_%,$(wildcard $(1)/*.c)))

.PHONY: all
all: $(PROGRAMS) $(GEN) ## build the programs, the object table and the DBC
	@:

$(BUILD)/obj/%.o: %.c | $(BUILD)/gen/od_values.h
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_CFLAGS) -c -o $@ $<

$(BUILD)/obj/gen/%.o: $(BUILD)/gen/%.c $(BUILD)/gen/od_values.h
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_CFLAGS) -c -o $@ $<

drivers/imu/pololu/drdy_gpiod-missing.c:
	@echo "$(PKG_CONFIG) finds no libgpiod: tools/deps build" >&2; exit 1

# a recording continues from the memory of struct device: the sources that give it its meaning and layout
BUILD_ID_SRC := $(sort $(filter-out gateway/main.c,$(wildcard model/*.[ch] model/math/*.[ch] model/identify/*.[ch] \
	od/*.[ch] gateway/*.[ch] gateway/canopen/*.[ch] drivers/ports/*.h)) eds/imu9-gateway.eds)
$(BUILD)/gen/build_id.h: $(BUILD_ID_SRC)
	@mkdir -p $(@D)
	@echo "#define BUILD_ID \"$$(cat $^ | sha256sum | cut -c1-16)-$$(echo __SIZEOF_POINTER__ __BYTE_ORDER__ | \
		$(CC) -E -P - | tr -d ' ')\"" >$@
$(BUILD)/obj/gateway/device_state.o: $(BUILD)/gen/build_id.h

# the generator is built before anything that needs what it generates
GEN_OD_SRC := $(call sources,tools/eds/*.c) $(OD_SRC)
$(BUILD)/gen-od: $(GEN_OD_SRC) $(wildcard od/*.h tools/eds/*.h)
	@mkdir -p $(@D)
	$(Q)$(CC_FOR_BUILD) $(filter-out -MMD -MP,$(ALL_CFLAGS)) -o $@ $(GEN_OD_SRC) -linih -lm

$(GEN) &: eds/imu9-gateway.eds $(BUILD)/gen-od
	@mkdir -p $(BUILD)/gen
	$(Q)$(BUILD)/gen-od $< $(BUILD)/gen

SPARKPLUG := $(BUILD)/gen/sparkplug_b.pb-c.c $(BUILD)/gen/sparkplug_b.pb-c.h
$(SPARKPLUG) &: tools/fleet/sparkplug_b.proto
	@mkdir -p $(BUILD)/gen
	$(Q)protoc-c --proto_path=$(<D) --c_out=$(BUILD)/gen $(<F)
$(call objects,tools/fleet/format_sparkplug.c): $(SPARKPLUG)

define archive =
	@rm -f $@
	$(Q)$(AR) rcs $@ $^
endef
$(MODEL_LIB): $(call objects,$(MODEL_SRC)); $(archive)
$(BUILD)/libod.a: $(call objects,$(OD_SRC)) $(BUILD)/obj/gen/od_table.o; $(archive)
$(BUILD)/libdrivers.a: $(call objects,$(DRIVERS_SRC)); $(archive)
$(BUILD)/libcanopen.a: $(call objects,$(CANOPEN_SRC)); $(archive)
$(BUILD)/libmodbus_server.a: $(call objects,$(MODBUS_SRC)) $(BUILD)/obj/gen/modbus_map.o; $(archive)
$(BUILD)/libgateway.a: $(call objects,$(GATEWAY_SRC)); $(archive)
$(BUILD)/libtools.a: $(call objects,$(TOOLS_SRC)); $(archive)
$(BUILD)/libfleet.a: $(call objects,$(FLEET_SRC)) $(BUILD)/obj/gen/sparkplug_b.pb-c.o; $(archive)

$(BUILD)/imu9-gateway: $(BUILD)/obj/gateway/main.o $(LIBS)
	$(Q)$(CC) $(CFLAGS) $(SAN) $(LDFLAGS) -o $@ $^ $(LDLIBS)

define program =
$$(BUILD)/$(subst _,-,$(notdir $(1))): $$(BUILD)/obj/$(1).o $$(LIBS)
	$$(Q)$$(CC) $$(CFLAGS) $$(SAN) $$(LDFLAGS) -o $$@ $$^ $$(LDLIBS)
endef
$(foreach s,$(basename $(PROGRAM_SRC)),$(eval $(call program,$(s))))

# The page is compiled into imu9-web, with Chart.js of Debian's libjs-chart.js. No other program needs libwebsockets.
CHART_JS ?= /usr/share/javascript/chart.js/chart.min.js
PAGE := $(filter-out %.md,$(wildcard tools/web/page/*)) $(CHART_JS)
$(BUILD)/gen/web_files.c: tools/web/embed $(PAGE)
	@mkdir -p $(@D)
	$(Q)tools/web/embed $(PAGE) >$@ || { rm -f $@; exit 1; }
$(CHART_JS):
	@echo "$@ is missing: tools/deps build" >&2; exit 1
$(BUILD)/imu9-web: $(BUILD)/obj/gen/web_files.o
$(BUILD)/imu9-web: LDLIBS += -lwebsockets
# the only programs that need these libraries
FLEET_PROGRAMS := $(BUILD)/imu9-fleet $(foreach t,$(TESTS) $(FUZZERS),$(if $(findstring _fleet,$(notdir $(t))),$(t)))
$(FLEET_PROGRAMS): $(BUILD)/libfleet.a
$(FLEET_PROGRAMS): LDLIBS := $(BUILD)/libfleet.a $(LIBS) -lmosquitto -lprotobuf-c $(LDLIBS)

.SECONDEXPANSION:
$(TESTS) $(BENCHES): $(BUILD)/tests/%: tests/%.c $$(call helpers,$$(patsubst %/,%,$$(dir tests/$$*))) $(LIBS)
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_CFLAGS) -o $@ $(filter %.c %.o %.a %.so,$^) -lcmocka $(LDLIBS)

$(BUILD)/tests/unit/test_i2c_drdy: $(BUILD)/obj/tests/unit/gpiod/gpiod$(GPIOD_API)_stub.o
$(BUILD)/tests/scenario/test_trace_device: $(BUILD)/obj/tests/unit/trace.o

$(SOAKS): $(BUILD)/%: %.c $(addprefix $(BUILD)/obj/tests/scenario/,world.o hammer.o browsers.o) $(LIBS)
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_CFLAGS) -o $@ $(filter %.c %.o %.a,$^) -lcmocka $(LDLIBS)

$(RIG_PROGRAMS) $(PLANT): $(BUILD)/tests/%: tests/%.c $(LIBS)
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_CFLAGS) -o $@ $< $(LIBS) $(LDLIBS)

Q = $(if $(V),,@echo "  build   $@";)

# ---- the two commands of the README --------------------------------------------------------------------------------
.PHONY: demo demo-web test
demo: ## install what is missing, build, and show the gateway at work (no hardware needed)
	@DEPS=$(DEPS) tools/deps build
	@$(MAKE) --no-print-directory -j2 all
	@BUILD=$(BUILD) tools/demo

demo-web: ## the same in the browser: two simulated nodes and imu9-web, which prints its address
	@DEPS=$(DEPS) tools/deps build
	@$(MAKE) --no-print-directory -j2 all
	@BUILD=$(BUILD) tools/web/demo

test: ## install what is missing, build, and run every test: unit, scenario, and interop on a real vcan
	@DEPS=$(DEPS) tools/deps build test
	@$(MAKE) --no-print-directory -j2 all tests check-layers check-objects
	@BUILD=$(BUILD) tests/run unit scenario interop page

.PHONY: rig test-rig
rig: ## what the drivers need to be tested without hardware: a guest kernel (five minutes, once), emulated adapters
	@DEPS=$(DEPS) tools/deps build test rig
	@tests/rig/kernel/build
	@$(MAKE) --no-print-directory -j2 all $(RIG_PROGRAMS)

test-rig: rig ## test them in there, through the kernel's own USB, CAN, I2C and IIO
	@BUILD=$(BUILD) tests/rig/run

.PHONY: experiments
experiments: ## the seed paper's figures and tables, and what beats them: build/experiments
	@DEPS=$(DEPS) tools/deps build experiments
	@$(MAKE) --no-print-directory -j2 all
	@$(BUILD)/imu9-sim experiments -o $(BUILD)/experiments

# ---- for developers ------------------------------------------------------------------------------------------------
.PHONY: tests check emulator distros asan ubsan tsan fuzz soak bench honesty score traces mutate lint analyze cov \
	format check-format check-reproducible check-layers check-objects readme check-readme eds-revision check-eds
tests: $(TESTS) ## build the tests only

emulator: ## print what runs the programs that CC builds here: nothing, or qemu
	@echo $(EMULATOR)

check: all tests check-objects ## unit and scenario tests only (seconds, no rig)
	@BUILD=$(BUILD) EMULATOR=$(EMULATOR) tests/run unit scenario

distros: ## build and test in clean roots of Debian 12 and 13, also cross-built (an hour; a part: tests/distros trixie)
	@tests/distros

# With sanitizers gcc warns of overflows that are none: there a warning is no error.
asan: ## unit and scenario tests with AddressSanitizer and UBSan
	@$(MAKE) --no-print-directory BUILD=$(BUILD)/asan WERROR=no \
		SAN="-fsanitize=address,undefined -fno-sanitize-recover=all" check

ubsan: ## unit and scenario tests with UBSan alone
	@$(MAKE) --no-print-directory BUILD=$(BUILD)/ubsan WERROR=no \
		SAN="-fsanitize=undefined -fno-sanitize-recover=all" check

tsan: ## unit and scenario tests with ThreadSanitizer
	@$(MAKE) --no-print-directory BUILD=$(BUILD)/tsan WERROR=no SAN="-fsanitize=thread" check

fuzz: ## run each libFuzzer target for FUZZ_SECONDS (needs clang)
	@$(MAKE) --no-print-directory -j2 BUILD=$(BUILD)/fuzz CC=clang \
		SAN="-fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=all" fuzzers
	@BUILD=$(BUILD)/fuzz tests/fuzz/run --seconds $(FUZZ_SECONDS)

.PHONY: fuzzers
fuzzers: $(FUZZERS)
$(FUZZERS): $(BUILD)/tests/fuzz/%: tests/fuzz/%.c tests/fuzz/fuzz.h tests/fuzz/fuzz_od.h $(LIBS)
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_CFLAGS) -fsanitize=fuzzer -o $@ $< $(LIBS) $(LDLIBS)

soak: $(SOAKS) ## simulated: the device for SOAK_DAYS (a week: ten minutes), its windows a day, imu9-web an hour
	@$(BUILD)/tests/soak/soak_device $(SOAK_DAYS)
	@$(BUILD)/tests/soak/soak_windows
	@$(BUILD)/tests/soak/soak_web

PLANT_NODES ?= 10
PLANT_BUSES ?= 2
PLANT_SECONDS ?= 9
.PHONY: plant
plant: $(BUILD)/imu9-fleet $(BUILD)/imu9-gateway $(PLANT) ## PLANT_NODES on PLANT_BUSES at one MQTT broker that restarts
	@DEPS=$(DEPS) tools/deps test
	@BUILD=$(BUILD) tests/plant/run --nodes $(PLANT_NODES) --buses $(PLANT_BUSES) --seconds $(PLANT_SECONDS)

bench: all $(BENCHES) ## print the measured figures
	@for b in $(filter-out %/bench_bus,$(BENCHES)); do echo "== $$(basename $$b)"; $$b || exit 1; done
	@echo "== bench_bus"; BUILD=$(BUILD) tests/rig/vcan-run $(BUILD)/tests/bench/bench_bus

# `git diff` then shows what the change does to the results. Conflicts of a merge there: take either side, then this.
TRACES := $(foreach t,$(TESTS),$(if $(findstring /test_trace_,$(t)),$(t)))
traces: $(TRACES) ## write tests/unit/traces/ again, after a change of results that is intended
	@for t in $(TRACES); do \
		IMU9_TRACES=write $$t >$(BUILD)/traces.log 2>&1 || { cat $(BUILD)/traces.log; exit 1; }; \
	done
	@git --no-pager diff --stat tests/unit/traces

mutate: ## put COUNT small faults into random lines of the code (SEED, LAYERS) and count those that a test catches
	@nice tests/mutate --count $(COUNT) --seed $(SEED) --layers $(LAYERS) --jobs $(JOBS)

lint: analyze ## clang-tidy, cppcheck and gcc -fanalyzer
	@printf '%s\n' $(MODEL_SRC) $(OD_SRC) $(DRIVERS_SRC) $(CANOPEN_SRC) $(MODBUS_SRC) $(GATEWAY_SRC) \
		$(TOOLS_SRC) $(FLEET_SRC) | \
		xargs -P $(shell nproc) -I FILE clang-tidy --quiet FILE -- $(filter-out -MMD -MP,$(ALL_CFLAGS))
	cppcheck --quiet --error-exitcode=1 --enable=warning,performance,portability --inline-suppr \
		--suppress=missingIncludeSystem --suppress=ctunullpointer:od/text.c -I. -I$(BUILD)/gen \
		model od drivers gateway tools

analyze: $(BUILD)/gen/od_values.h $(BUILD)/gen/build_id.h $(SPARKPLUG) ## gcc -fanalyzer alone
	@printf '%s\n' $(MODEL_SRC) $(OD_SRC) $(DRIVERS_SRC) $(CANOPEN_SRC) $(MODBUS_SRC) $(GATEWAY_SRC) \
		$(TOOLS_SRC) $(FLEET_SRC) $(PROGRAM_SRC) gateway/main.c tools/eds/gen_od.c | \
		tests/analyze $(filter-out -MMD -MP,$(ALL_CFLAGS))

cov: ## line and branch coverage of the unit and scenario tests
	@$(MAKE) --no-print-directory BUILD=$(BUILD)/cov CFLAGS="-O0 -g --coverage" check
	@tests/coverage -p $(BUILD)/cov

FORMATTED = $(shell git ls-files '*.c' '*.h')
PYTHON = $(shell git ls-files '*.py' tests/mutate tests/honesty tests/score tests/interop/run tests/page/run \
	tests/plant/run)
format: ## apply .clang-format
	clang-format -i $(FORMATTED)

# clang-format breaks no comments. Shell scripts are not checked: regular expressions and lines of test data.
check-format: ## fail when a file is not formatted
	@clang-format --dry-run --Werror $(FORMATTED)
	@awk -F '\t' '{w = 0; for (i = 1; i < NF; i++) w += length($$i) + 8 - (w + length($$i)) % 8; \
		w += length($$NF)} w > 120 {print FILENAME ":" FNR ": " w " columns, at most 120"; bad = 1} \
		END {exit bad}' Makefile $(FORMATTED) $(PYTHON)

check-reproducible: $(PROGRAMS) ## fail when a second build, in another folder, gives other bytes
	@CC="$(CC)" WERROR=$(WERROR) tests/reproducible $(PROGRAMS)

WITH_OBJECTS = awk '/^<!-- objects/ {print; system("sed -n \"/^\#\# /,$$ p\" $(BUILD)/gen/objects.md"); skip = 1} \
	/^<!-- end of objects/ {skip = 0} !skip' eds/README.md
readme: $(BUILD)/gen/objects.md ## bring the object tables of eds/README.md up to date
	@$(WITH_OBJECTS) >$(BUILD)/README.md && cp $(BUILD)/README.md eds/README.md

check-readme: $(BUILD)/gen/objects.md ## fail when the object tables of eds/README.md are not those of the EDS
	@$(WITH_OBJECTS) | cmp -s - eds/README.md || \
		{ echo "eds/README.md: the object tables are out of date: make readme" >&2; exit 1; }

EDS_XDD = tools/eds/eds-xdd eds/imu9-gateway.eds
eds-revision: ## raise the revision of the changed EDS, write the XDD (MAJOR=yes: an object means something else)
	@tools/eds/eds-revision eds/imu9-gateway.eds $(if $(filter yes,$(MAJOR)),major,minor)
	@mkdir -p $(BUILD)
	@$(EDS_XDD) >$(BUILD)/imu9-gateway.xdd && cp $(BUILD)/imu9-gateway.xdd eds

check-eds: ## fail when the EDS changed and its revision or the XDD did not
	@tools/eds/eds-revision eds/imu9-gateway.eds check
	@$(EDS_XDD) | cmp -s - eds/imu9-gateway.xdd || \
		{ echo "eds/imu9-gateway.xdd is out of date: make eds-revision" >&2; exit 1; }

DRIVERS_README = drivers/readme-tables $(BUILD)/imu9-gateway drivers/README.md
.PHONY: drivers-readme check-drivers-readme
readme: drivers-readme
check-readme: check-drivers-readme
drivers-readme: $(BUILD)/imu9-gateway ## bring the tables of sensors and buses in drivers/README.md up to date
	@$(DRIVERS_README) >$(BUILD)/drivers-README.md && cp $(BUILD)/drivers-README.md drivers/README.md

check-drivers-readme: $(BUILD)/imu9-gateway ## fail when these tables are not those of --help
	@$(DRIVERS_README) | cmp -s - drivers/README.md || \
		{ echo "drivers/README.md: the tables are out of date: make readme" >&2; exit 1; }

WITH_REGISTERS = awk '/^<!-- registers/ {print; print ""; system("cat $(BUILD)/gen/modbus.md"); skip = 1} \
	/^<!-- end of registers/ {skip = 0; print ""} !skip' gateway/modbus/README.md
.PHONY: modbus-readme check-modbus-readme
readme: modbus-readme
check-readme: check-modbus-readme
modbus-readme: $(BUILD)/gen/modbus.md ## bring the registers of gateway/modbus/README.md up to date
	@$(WITH_REGISTERS) >$(BUILD)/modbus-README.md && cp $(BUILD)/modbus-README.md gateway/modbus/README.md

check-modbus-readme: $(BUILD)/gen/modbus.md ## fail when these registers are not those of the EDS
	@$(WITH_REGISTERS) | cmp -s - gateway/modbus/README.md || \
		{ echo "gateway/modbus/README.md: the registers are out of date: make readme" >&2; exit 1; }

# one place for all tests on recorded trials: they read IMU9_BROAD
BROAD ?= $(or $(IMU9_BROAD),../shared/data/broad)
export IMU9_BROAD := $(abspath $(BROAD))
score: all ## replay the trials in BROAD=DIR and compare them with their optical reference
	@DEPS=$(DEPS) tools/deps score
	@BUILD=$(BUILD) tests/score $(BROAD)

SEEDS ?= 1 2 3
honesty: all ## replay simulated motions, and the trials in BROAD=DIR if there are any: do the errors fit the sigmas?
	@DEPS=$(DEPS) tools/deps score
	@BUILD=$(BUILD) tests/honesty --seeds $(SEEDS) $(if $(wildcard $(BROAD)/*.imu.csv),--broad $(BROAD))

PURE_LIBS := $(MODEL_LIB) $(BUILD)/libod.a $(BUILD)/libcanopen.a $(BUILD)/libgateway.a
check-layers: $(PURE_LIBS) ## fail when a layer includes or needs what it must not
	@tests/check-layers $(PURE_LIBS)
	@tests/check-emcy

check-docs: ## fail when a link or a file name in a Markdown file leads nowhere
	@tests/check-docs

check-objects: $(BUILD)/gen/od_table.c $(BUILD)/gen/build_id.h ## fail when nothing uses an object of the EDS
	@tests/check-objects $(BUILD) "$(CC)"

# ---- installing ----------------------------------------------------------------------------------------------------
.PHONY: man deb install uninstall clean help check-docs
MAN := $(patsubst $(BUILD)/%,$(BUILD)/man/%.1,$(PROGRAMS))
man: $(MAN) ## manual pages, made from --help (needs help2man)
$(MAN): $(BUILD)/man/%.1: $(BUILD)/% tools/man-page
	@mkdir -p $(@D)
	$(Q)tools/man-page $< >$@

# where the system looks for units and rules; a package knows better
LIBDIR ?= $(PREFIX)/lib
UNITDIR ?= $(LIBDIR)/systemd/system
UDEVDIR ?= $(LIBDIR)/udev
COMPLETIONS ?= $(PREFIX)/share/bash-completion/completions
share = $(PREFIX)/share/imu9-gateway
UNIT := tools/service/imu9-gateway.service
fleet_share = $(PREFIX)/share/imu9-fleet
FLEET_FILES := imu9-fleet.conf sparkplug_b.proto telegraf.conf grafana-dashboard.json
OWN_NAMES := $(notdir $(PROGRAMS))
install: all $(if $(shell command -v help2man),man) ## install programs, manuals and units under $(DESTDIR)$(PREFIX)
	install -d $(addprefix $(DESTDIR),$(PREFIX)/bin $(share) $(fleet_share) \
		$(UDEVDIR)/rules.d $(UNITDIR) $(LIBDIR)/sysusers.d $(COMPLETIONS) $(PREFIX)/share/man/man1)
	install -m 755 $(PROGRAMS) $(DESTDIR)$(PREFIX)/bin
	install -m 644 eds/imu9-gateway.eds eds/imu9-gateway.xdd $(BUILD)/gen/imu9-gateway.dbc $(BUILD)/gen/objects.md \
		$(addprefix $(BUILD)/gen/modbus,.csv -telegraf.conf -node-red.json) tools/service/imu9-gateway.conf \
		$(addprefix tools/service/,udp.conf realtime.conf modbus.conf modbus-stunnel.conf) \
		tools/imu9-json.schema.json $(DESTDIR)$(share)
	install -m 644 tools/service/70-imu9-gateway.rules $(DESTDIR)$(UDEVDIR)/rules.d
	install -m 644 tools/service/sysusers.conf $(DESTDIR)$(LIBDIR)/sysusers.d/imu9-gateway.conf
	for name in imu9-gateway imu9-sdo; do \
		install -m 644 tools/service/completion.bash $(DESTDIR)$(COMPLETIONS)/$$name; done
	for name in $(filter-out imu9-gateway imu9-sdo,$(OWN_NAMES)); do \
		ln -sf imu9-sdo $(DESTDIR)$(COMPLETIONS)/$$name; done
	$(foreach page,$(wildcard $(MAN)),install -m 644 $(page) $(DESTDIR)$(PREFIX)/share/man/man1 &&) :
	sed 's|@PREFIX@|$(PREFIX)|g' $(UNIT) >$(DESTDIR)$(UNITDIR)/imu9-gateway.service
	sed -e 's|@PREFIX@|$(PREFIX)|g; s|/etc/imu9-gateway.conf|/etc/imu9-gateway/%i.conf|g' \
		-e 's|^Description=.*|& %i|; s|^\[Service\]|&\nEnvironment=IMU9_CAN=%i|' \
		$(UNIT) >$(DESTDIR)$(UNITDIR)/imu9-gateway@.service
	install -m 644 $(addprefix tools/fleet/,$(FLEET_FILES)) $(DESTDIR)$(fleet_share)
	sed 's|@PREFIX@|$(PREFIX)|g' tools/service/imu9-fleet@.service >$(DESTDIR)$(UNITDIR)/imu9-fleet@.service
	$(if $(DESTDIR),,-systemd-sysusers $(LIBDIR)/sysusers.d/imu9-gateway.conf)

uninstall: ## remove what install put there
	rm -f $(addprefix $(DESTDIR)$(PREFIX)/bin/,$(OWN_NAMES)) $(addprefix $(DESTDIR)$(COMPLETIONS)/,$(OWN_NAMES))
	rm -f $(patsubst %,$(DESTDIR)$(PREFIX)/share/man/man1/%.1,$(OWN_NAMES))
	rm -rf $(DESTDIR)$(share) $(DESTDIR)$(fleet_share)
	rm -f $(DESTDIR)$(UDEVDIR)/rules.d/70-imu9-gateway.rules $(DESTDIR)$(LIBDIR)/sysusers.d/imu9-gateway.conf
	rm -f $(addprefix $(DESTDIR)$(UNITDIR)/,imu9-gateway.service imu9-gateway@.service imu9-fleet@.service)

deb: ## Debian packages: $(BUILD)/deb (needs debhelper, help2man and fakeroot: tools/deps package)
	@DEPS=$(DEPS) tools/deps build package
	@BUILD=$(BUILD) VERSION=$(VERSION) debian/build

clean: ## remove everything built
	rm -rf $(BUILD)

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' Makefile

-include $(shell find $(BUILD) -name '*.d' -type f 2>/dev/null)
