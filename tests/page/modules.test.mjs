/* The pure modules of the page. Expected values are closed forms, or written by hand. */
import assert from "node:assert/strict";
import {test} from "node:test";

const page = "../../tools/web/page/";
const {to_csv} = await import(page + "csv.js");
const {fft, spectrum} = await import(page + "fft.js");
const {from_angles, from_quaternion, to_angles, apply, without_gravity} = await import(page + "rotation.js");
const {Series} = await import(page + "series.js");
const {Signals} = await import(page + "signals.js");
const {fixed, label_of, unit_text} = await import(page + "text.js");
const {live_can_ids} = await import(page + "live.js");
const {missing_axes} = await import(page + "calibration.js");
const {moved, bits_of, type_text} = await import(page + "pdo.js");
const {parse_number, outside, is_default} = await import(page + "field.js");
const {search} = await import(page + "objects.js");
const {Poses, READINGS} = await import(page + "mounting.js");
const {SIDES} = await import(page + "drawings.js");

const near = (a, b, most = 1e-9) => assert.ok(Math.abs(a - b) <= most, `${a} is not ${b}`);
const all_near = (a, b, most) => b.forEach((v, i) => near(a[i], v, most));

test("the transform of an impulse is one everywhere", () => {
  const re = new Float64Array(16),
    im = new Float64Array(16);
  re[0] = 1;
  fft(re, im);
  for (let k = 0; k < 16; k++) {
    near(re[k], 1);
    near(im[k], 0);
  }
});

test("the transform is the sum of its definition", () => {
  const n = 32,
    x = Array.from({length: n}, (_, i) => Math.sin(i * i)),
    re = Float64Array.from(x),
    im = new Float64Array(n);
  fft(re, im);
  for (let k = 0; k < n; k++) {
    near(re[k], x.reduce((sum, v, i) => sum + v * Math.cos((2 * Math.PI * k * i) / n), 0), 1e-9);
    near(im[k], x.reduce((sum, v, i) => sum - v * Math.sin((2 * Math.PI * k * i) / n), 0), 1e-9);
  }
});

test("a sine is at its frequency, and its power is half of its squared amplitude", () => {
  const rate = 100,
    found = spectrum(Array.from({length: 2048}, (_, i) => 5 + 2 * Math.sin((2 * Math.PI * 12.5 * i) / rate)), rate);
  const power = found.density.map((d) => d * d),
    peak = power.indexOf(Math.max(...power));
  near(found.hz[peak], 12.5);
  near(power.reduce((sum, p) => sum + p, 0) * (found.hz[1] - found.hz[0]), 2, 0.01);
});

test("fewer samples than a segment have no spectrum", () => assert.equal(spectrum(new Array(255).fill(0), 100), null));

test("yaw turns l from east to north, pitch lowers it, roll turns s up", () => {
  all_near(apply(from_angles(0, 0, 90), [1, 0, 0]), [0, 1, 0]);
  all_near(apply(from_angles(0, 90, 0), [1, 0, 0]), [0, 0, -1]);
  all_near(apply(from_angles(90, 0, 0), [0, 1, 0]), [0, 0, 1]);
});

test("a quaternion and its angles are one matrix, and angles come back", () => {
  const [w, x, y, z] = [0.5, 0.5, 0.5, 0.5]; /* l to north, s to up, t to east */
  const r = from_quaternion([w, x, y, z]);
  all_near(apply(r, [1, 0, 0]), [0, 1, 0]);
  all_near(apply(r, [0, 1, 0]), [0, 0, 1]);
  all_near(to_angles(from_angles(12, -34, 156)), [12, -34, 156]);
});

test("with l upright or down, the angles are those of the same rotation, with roll 0", () => {
  for (const pitch of [90, -90]) {
    const r = from_angles(30, pitch, 50),
      [roll, found, yaw] = to_angles(r);
    near(roll, 0);
    near(found, pitch, 1e-5);
    from_angles(roll, found, yaw).forEach((row, i) => all_near(row, r[i], 1e-6));
  }
});

test("at rest nothing is left of the force without gravity, in any attitude", () => {
  const r = from_angles(30, -50, 70),
    force = [0, 1, 2].map((i) => 9.81 * r[2][i]);
  all_near(without_gravity(force, r, 9.81), [0, 0, 0]);
});

test("CSV quotes commas, quotes and line ends, and leaves null empty", () => {
  assert.equal(to_csv(["t [s]", "a,b"], [[1, 'x"y'], [2.5, null]]), 't [s],"a,b"\n1,"x""y"\n2.5,\n');
});

test("a series keeps the latest, and its points keep the peaks", () => {
  const series = new Series(1, 1000);
  for (let i = 0; i < 1500; i++)
    series.push(i / 100, [i === 1234 ? 9 : i % 7 ? 0 : -1]);
  assert.equal(series.count, 1000);
  const points = series.points(0, 14.99, 10, 50);
  assert.ok(points.length < 120);
  assert.equal(Math.max(...points.map((p) => p.y)), 9);
  near(points.find((p) => p.y === 9).x, 12.34 - 14.99);
  assert.equal(Math.min(...points.map((p) => p.y)), -1);
  assert.ok(points.every((p, i) => i === 0 || p.x >= points[i - 1].x));
});

test("a second without samples is a hole in the line", () => {
  const series = new Series(1);
  [0, 0.1, 5, 5.1].forEach((t) => series.push(t, [1]));
  const holes = series.points(0, 5.1, 10).map((p) => Number.isNaN(p.y));
  assert.deepEqual(holes, [false, false, true, false, false]);
});

const fields = [
  ...["l", "s", "t"].map((axis) => ({name: `acceleration.${axis}`, pdo: 1})),
  {name: "sample.counter", pdo: 1},
  ...["roll", "pitch", "yaw"].map((axis) => ({name: `angles.${axis}`, pdo: 2})),
  ...["l", "s", "t"].map((axis) => ({name: `specific_force16.${axis}`, pdo: 5})),
  {name: "sample.counter", pdo: 5},
];

test("rows become vectors, and the acceleration before the correction", () => {
  const signals = new Signals();
  signals.map(fields);
  signals.rows([[1, 0.1, 0.2, 0.3, 7, 0, 0, 90, 1, 0, 9.81, 7]]);
  all_near(signals.series.acceleration.latest(), [0.1, 0.2, 0.3]);
  all_near(signals.series.angles.latest(), [0, 0, 90]);
  all_near(signals.series.before.latest(), [1, 0, 0]);
  assert.ok(!signals.missing().includes("specific_force.l"));
  assert.ok(signals.missing().includes("angular_rate.l"));
});

test("a repeated sample counts once for the spectrum, a skipped one is interpolated and counted", () => {
  const signals = new Signals();
  signals.map(fields);
  const row = (t, counter, force) => [t, 0, 0, 0, counter, 0, 0, 0, force, 0, 9.81, counter];
  signals.rows([row(0, 65534, 1), row(0.01, 65534, 1), row(0.02, 65535, 2), row(0.04, 1, 4)]);
  assert.deepEqual(signals.series.vibration.tail(0, 10), [1, 2, 3, 4]);
  assert.equal(signals.counts.skipped, 1);
});

test("null in a row is no value", () => {
  const signals = new Signals();
  signals.map(fields);
  signals.rows([[1, null, null, null, null, 1, 2, 3, null, null, null, null]]);
  assert.equal(signals.series.acceleration.latest(), null);
  all_near(signals.series.angles.latest(), [1, 2, 3]);
});

test("by SDO comes what the PDOs lack", () => {
  const signals = new Signals();
  signals.polled(["l", "s", "t"].map((axis, i) => ({name: `angular_rate.${axis}`, value: i})));
  all_near(signals.series.rate.latest(), [0, 1, 2]);
  signals.map(fields);
  signals.rows([[1, 1, 1, 1, 7, 0, 0, 90, 1, 0, 9.81, 7]]);
  signals.polled(["l", "s", "t"].map((axis) => ({name: `acceleration_object.${axis}`, value: 5})));
  all_near(signals.series.acceleration.latest(), [1, 1, 1]);
});

test("the axis that turns least is missing; later those across the least certain component", () => {
  assert.deepEqual(missing_axes([0, 0, 0], [1, 0.9, 0.1]), ["t"]);
  assert.deepEqual(missing_axes([0, 0, 0], [0.1, 0.1, 0.1]), ["l", "s", "t"]);
  assert.deepEqual(missing_axes([0.004, 0.001, 0.001], [1, 1, 1]), ["s", "t"]);
  assert.deepEqual(missing_axes([0.0015, 0.0004, 0.0004], [1, 1, 1]), []);
});

test("entries of a PDO move within their list, and their bits add up", () => {
  assert.deepEqual(moved(["a", "b", "c"], 0, 1), ["b", "a", "c"]);
  assert.deepEqual(moved(["a", "b", "c"], 2, 0), ["c", "a", "b"]);
  assert.deepEqual(moved(["a", "b", "c"], 0, -1), ["a", "b", "c"]);
  assert.equal(bits_of(["a", "b"], new Map([["a", {bits_size: 16}], ["b", {bits_size: 32}]])), 48);
});

test("every transmission type of CiA 301 has its words", () => {
  for (const type of [0, 1, 2, 240, 252, 253, 254, 255])
    assert.notEqual(type_text(type), type_text(241), String(type));
  assert.equal(type_text(241), type_text(251));
});

test("numbers are decimal with point or comma, or hexadecimal", () => {
  assert.equal(parse_number("0.05"), 0.05);
  assert.equal(parse_number("−1,5"), -1.5);
  assert.equal(parse_number("181h"), 0x181);
  assert.equal(parse_number("0x40000181"), 0x40000181);
  assert.ok(Number.isNaN(parse_number("")));
  assert.ok(Number.isNaN(parse_number("five")));
});

test("limits hold at both ends and belong to the range", () => {
  const arm = {low: -10, high: 10, unit: "m"};
  assert.equal(outside(arm, 10), null);
  assert.match(outside(arm, 10.001), /-10 to 10 m/);
  assert.ok(outside(arm, NaN));
  assert.equal(outside({}, 1e9), null);
});

test("a default is compared as REAL32", () => {
  assert.equal(is_default({default: 0.041}, Math.fround(0.041)), true);
  assert.equal(is_default({default: 0.041}, 0.0411), false);
  assert.equal(is_default({}, 1), null);
});

test("a search finds names, indices, words and meanings", () => {
  const list = [
    {name: "lever_arm.l", index: "2000h", sub: 1, record: "Lever arm", text: "ahead of the reference point"},
    {name: "position.motion_preset", index: "2040h", sub: 10, record: "Position", text: "", words: {7: "hanging_load"}},
  ];
  const found = (query) => search(list, query).map((object) => object.name);
  assert.deepEqual(found("2000h:1"), ["lever_arm.l"]);
  assert.deepEqual(found("reference lever"), ["lever_arm.l"]);
  assert.deepEqual(found("hanging"), ["position.motion_preset"]);
  assert.equal(found("").length, 2);
});

test("numbers have a true minus sign, and no minus zero", () => {
  assert.equal(fixed(-1.25, 1), "−1.3");
  assert.equal(fixed(-0.001, 2), "0.00");
});

test("units and names are in the signs of print", () => {
  assert.equal(unit_text("m/s^2"), "m/s²");
  assert.equal(unit_text("deg/s/sqrt(Hz)"), "°/s/√Hz");
  assert.equal(unit_text("0.1 ms"), "0.1 ms");
  assert.equal(label_of("tpdo1_communication.cob_id"), "TPDO1 communication · COB-ID");
});

test("the sides are those of 2061h: six faces, eight corners", () => {
  assert.equal(SIDES.length, 14);
  assert.deepEqual(SIDES[3], [0, -1, 0]);
  assert.deepEqual(SIDES[6], [1, 1, 1]);
  assert.deepEqual(SIDES[13], [-1, -1, -1]);
});

test("two free CAN-IDs are found for TPDO5 and 6 of every node, its own ones first", () => {
  const none = new Set();
  assert.deepEqual(live_can_ids(1, [1], none), [0x680, 0x681]);
  assert.deepEqual(live_can_ids(48, [1, 48], none), [0x6de, 0x6df]);
  assert.deepEqual(live_can_ids(49, [49], none), [0x6de, 0x6df]);
  assert.deepEqual(live_can_ids(127, [48, 49, 127], none), [0x6dc, 0x6dd]);
  assert.deepEqual(live_can_ids(127, [49, 127], new Set([0x6de, 0x6df])), [0x6dc, 0x6dd]);
  assert.deepEqual(live_can_ids(48, [48, 49], new Set([0x6df])), [0x6dc, 0x6dd]);
  const first = Array.from({length: 48}, (_, i) => i + 1);
  assert.equal(live_can_ids(100, [...first, 100], none), null);
});

/* Specific force in the object frame: level, or with the front raised by an angle about s. */
const raised = (deg) => [9.81 * Math.sin((deg * Math.PI) / 180), 0, 9.81 * Math.cos((deg * Math.PI) / 180)];

/* Force along the axes of a sensor that is turned by these angles in the object. */
const in_sensor = (angles, force) => {
  const r = from_angles(...angles);
  return [0, 1, 2].map((k) => r[0][k] * force[0] + r[1][k] * force[1] + r[2][k] * force[2]);
};

test("two poses give the mounting, whatever mounting was in use", () => {
  for (const true_angles of [
    [0, 0, 0],
    [20, -35, 110],
    [179, 0, 0],
    [-90, 0, 90],
    [5, 89, -170],
    [120, 60, -60],
  ])
    for (const used of [
      [0, 0, 0],
      [-40, 25, 75],
    ]) {
      const poses = new Poses();
      for (const deg of [0, 50])
        for (let i = 0; i < READINGS; i++)
          assert.equal(
            poses.take(apply(from_angles(...used), in_sensor(true_angles, raised(deg))), used, true),
            "still"
          );
      const found = poses.result();
      all_near(apply(from_angles(...found.angles), in_sensor(true_angles, [1, 2, 3])), [1, 2, 3], 1e-9);
      near(found.apart, 50);
    }
});

test("a pose begins anew when the sensor moves, and the second one counts when it is raised by 20 degrees", () => {
  const poses = new Poses(),
    take = (deg, rest) => poses.take(raised(deg), [0, 0, 0], rest);
  for (let i = 1; i < READINGS; i++) take(0, true);
  assert.equal(take(0, false), "moving");
  assert.equal(poses.count, 0);
  for (let i = 0; i < READINGS; i++) take(0, true);
  assert.equal(poses.done.length, 1);
  assert.equal(take(19, true), "low");
  assert.equal(poses.count, 0);
  assert.equal(take(21, true), "still");
  near(poses.raised_deg, 21);
});

test("the sigma of the mounting is that of the mean of the readings", () => {
  const poses = new Poses(),
    error = 0.01; /* m/s^2 on each axis, in turn up and down, and none for the last reading */
  for (const deg of [0, 90])
    for (let i = 0; i < READINGS; i++) {
      const e = i === READINGS - 1 ? 0 : i % 2 ? error : -error;
      poses.take(
        raised(deg).map((f) => f + e),
        [0, 0, 0],
        true
      );
    }
  /* the variance of a reading is error^2, by 24 deviations and 24 degrees of freedom */
  const expected = ((error / 5 / 9.81) * 180) / Math.PI;
  near(poses.result().tilt, expected, 1e-6);
  near(poses.result().heading, expected, 1e-6);
});
