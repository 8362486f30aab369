/* Guided calibrations (2061h), the mounting (2053h) and the identification of the lever arm (2060h). The page says what
 * to do, shows how far it is, and asks whether to accept. The node measures and judges; only the mounting is computed
 * here, of what the node measures at rest. */
import {button, card, fill, h, say} from "./dom.js";
import {about_a_point, in_field, mounted, rest, side_up} from "./drawings.js";
import {Poses, READINGS} from "./mounting.js";
import {T} from "./strings.js";
import {fixed, numeric} from "./text.js";

const POLL_HZ = 5;
const RUNNING = "running",
  DONE = "done",
  REFUSED = "refused";
const AXES = ["l", "s", "t"];
/* By judgement, as imu9-calibrate does it: an axis is missing while its rate is less than this share of the largest
 * one; later a component that is this much less certain than the best, and by more than 2 mm. */
const SLOW_SHARE = 0.3,
  SLOW_RAD_S = 0.3,
  UNSURE_RATIO = 2,
  UNSURE_M = 0.002;

const CALIBRATION = {
  record: "calibration",
  accept: "accept",
  discard: "discard",
  polled: ["state", "kind", "verdict", "progress", "positions", "positions_wanted", "next_side", "coverage"].map(
    (member) => `calibration.${member}`
  ),
};
const LEVER = {
  record: "lever_arm_identification",
  accept: "accept",
  discard: "discard",
  polled: [
    ...["state", "verdict", "progress", "l", "s", "t", "sigma_l", "sigma_s", "sigma_t"].map(
      (member) => `lever_arm_identification.${member}`
    ),
    ...AXES.map((axis) => `angular_rate.${axis}`),
  ],
};
const FORCE = AXES.map((axis) => `specific_force.${axis}`);
const ANGLES = ["roll", "pitch", "yaw"];
const MOUNTING = ANGLES.map((angle) => `mounting.${angle}`);

const PROCEDURES = [
  {key: "gyro", start: "gyro", ...CALIBRATION, draw: () => rest(T.calibration.gyro.drawing)},
  {key: "accelerometer_free", start: "accelerometer_free", ...CALIBRATION, sides: true},
  {key: "accelerometer_six", start: "accelerometer_six", ...CALIBRATION, sides: true},
  {
    key: "magnetometer",
    start: "magnetometer",
    ...CALIBRATION,
    draw: () => in_field(T.calibration.magnetometer.drawing),
  },
  {
    key: "mounting",
    polled: ["sample.status", ...FORCE, ...MOUNTING],
    draw: () => mounted(false, T.calibration.mounting.drawing),
  },
  {key: "lever_arm", start: "start_held", ...LEVER, draw: () => about_a_point(T.calibration.lever_arm.drawing)},
];

/** Axes about which more rotation is needed, for example ["t"]; empty: all are there. From 1 sigma once it is known (a
 * rotation about an axis shows the components across it), before that from the RMS of the rates. */
export function missing_axes(sigma_m, rate_rad_s) {
  if (sigma_m[0] > 0) {
    const worst = sigma_m.indexOf(Math.max(...sigma_m)),
      best = Math.min(...sigma_m);
    return sigma_m[worst] > UNSURE_M && sigma_m[worst] > UNSURE_RATIO * best ? AXES.filter((_, i) => i !== worst) : [];
  }
  const most = Math.max(...rate_rad_s);
  return AXES.filter((_, i) => most < SLOW_RAD_S || rate_rad_s[i] < SLOW_SHARE * most);
}

function bar(name, properties) {
  const inner = h("div", {class: "bar-inner"}),
    value = h("span", {class: "number"});
  const element = h(
    "div",
    {class: "bar-row"},
    h("span", {}, name),
    h(
      "div",
      {
        class: "bar",
        role: "progressbar",
        "aria-label": name,
        "aria-valuemin": 0,
        "aria-valuemax": 100,
        ...properties,
      },
      inner
    ),
    value
  );
  return {
    element,
    show(share, text) {
      const percent = Math.round(100 * Math.min(1, Math.max(0, share)));
      inner.style.width = `${percent}%`;
      element.children[1].setAttribute("aria-valuenow", percent);
      say(value, text ?? `${percent} %`);
    },
  };
}

/* One for each position or pose that is wanted, with those that are done. */
function show_dots(dots, done, wanted) {
  if (dots.children.length === wanted && dots.dataset.done === String(done)) return;
  dots.dataset.done = done;
  fill(
    dots,
    Array.from({length: wanted}, (_, i) => h("li", {class: i < done ? "done" : ""}))
  );
}

const guide_layout = (drawing, ...text) =>
  h("div", {class: "guide"}, drawing, h("div", {class: "guide-text"}, ...text));

/** What is shown while the two poses of the mounting are taken: {element, show(state, poses)}, state as of
 * Poses.take(). */
function pose_guide() {
  const what = h("p", {class: "now", role: "status"}),
    drawing = h("div", {class: "big-drawing"}),
    dots = h("ol", {class: "dots", "aria-hidden": "true"});
  const progress = bar(T.calibration.progress),
    raised = bar(T.calibration.raised);
  let pose = null;
  return {
    element: guide_layout(drawing, what, dots, progress.element, raised.element),
    show(state, poses) {
      if (pose !== poses.done.length) {
        pose = poses.done.length;
        const {drawing: level, raised_drawing} = T.calibration.mounting;
        fill(drawing, mounted(pose > 0, pose ? raised_drawing : level));
        raised.element.hidden = pose === 0;
      }
      show_dots(dots, pose, 2);
      progress.show(poses.count / READINGS);
      raised.show(poses.raised_deg / 90, `${fixed(poses.raised_deg, 0)}°`);
      const hint = {moving: T.calibration.moving, still: T.calibration.still}[state] ?? "";
      say(what, `${pose ? T.calibration.raise : T.calibration.level} ${hint}`);
    },
  };
}

/** What is shown while a procedure of the node runs: {element, show(values)}, values by member. */
function guide(procedure) {
  const what = h("p", {class: "now", role: "status"}),
    drawing = h("div", {class: "big-drawing"});
  const progress = bar(T.calibration.progress),
    bars = [progress];
  const dots = h("ol", {class: "dots", "aria-hidden": "true"});
  let side = null,
    rates = [0, 0, 0],
    count = 0,
    coverage = null,
    sigma = [];
  if (procedure.draw) fill(drawing, procedure.draw());
  if (procedure.key === "magnetometer") bars.push((coverage = bar(T.calibration.coverage)));
  if (procedure.key === "lever_arm") bars.push(...(sigma = AXES.map((axis) => bar(T.calibration.certainty(axis)))));
  return {
    element: guide_layout(
      drawing,
      what,
      dots,
      bars.map((b) => b.element)
    ),
    show(v) {
      progress.show((v.progress ?? 0) / 100);
      if (procedure.sides) {
        if (side !== v.next_side) {
          side = v.next_side;
          fill(drawing, side_up(side, T.calibration.side_drawing(T.calibration.sides[side] ?? "")));
        }
        show_dots(dots, v.positions, v.positions_wanted);
        say(
          what,
          T.calibration.hold(v.positions, v.positions_wanted, T.calibration.sides[side] ?? T.calibration.sides[0])
        );
      } else if (procedure.key === "magnetometer") {
        coverage.show((v.coverage ?? 0) / 100);
        say(what, v.next_side ? T.calibration.field_missing(T.calibration.sides[v.next_side]) : T.calibration.turn_all);
      } else if (procedure.key === "lever_arm") {
        count++;
        rates = AXES.map((axis, i) => rates[i] + (v[`rate_${axis}`] ?? 0) ** 2);
        const known = AXES.map((axis) => v[`sigma_${axis}`]);
        AXES.forEach((axis, i) =>
          sigma[i].show(
            known[i] > 0 ? Math.min(1, 0.001 / known[i]) : 0,
            known[i] > 0 ? `${fixed(1e3 * v[axis], 1)} ± ${fixed(1e3 * known[i], 1)} mm` : "–"
          )
        );
        const axes = missing_axes(
          known,
          rates.map((sum) => Math.sqrt(sum / count))
        );
        say(what, axes.length ? T.calibration.turn_more(axes) : T.calibration.go_on);
      } else {
        say(what, T.calibration.do_not_touch);
      }
    },
  };
}

const line = (name, cells, unit) =>
  h(
    "tr",
    {},
    h("th", {scope: "row"}, name),
    cells.map((cell) => h("td", {class: "number"}, cell)),
    h("td", {class: "unit"}, unit)
  );
const table = (...lines) => h("table", {class: "result"}, h("tbody", {}, ...lines));

/** What Poses.result() has, and the mounting before, as a table. */
function mounting_table(found, before) {
  return table(
    ANGLES.map((angle, i) =>
      line(T.calibration.angles[angle], [fixed(found.angles[i], 2)], `° (${T.calibration.was(fixed(before[i], 2))})`)
    ),
    line(T.calibration.tilt_sigma, [fixed(found.tilt, 3)], "°"),
    line(T.calibration.heading_sigma, [fixed(found.heading, 3)], "°"),
    line(T.calibration.apart, [fixed(found.apart, 1)], "°")
  );
}

/** The result of a procedure of the node as a table; values by member. */
function result_table(procedure, v) {
  if (procedure.key === "lever_arm")
    return table(
      AXES.map((axis) =>
        line(axis, [`${fixed(1e3 * v[axis], 2)} ± ${fixed(1e3 * v[`sigma_${axis}`], 2)}`], "mm (1 sigma)")
      ),
      line(T.calibration.residual, [fixed(v.residual, 3)], "m/s² RMS")
    );
  const unit = {gyro: "rad/s", magnetometer: "µT"}[procedure.key] ?? "m/s²",
    rows = [];
  const of = (names) => names.map((name) => numeric(Number((v[name] ?? NaN).toPrecision(5))));
  rows.push(line(T.calibration.bias, of(["bias_x", "bias_y", "bias_z"]), unit));
  if (procedure.key !== "gyro")
    ["x", "y", "z"].forEach((r, i) =>
      rows.push(line(i ? "" : T.calibration.matrix, of(["x", "y", "z"].map((c) => r + c)), ""))
    );
  rows.push(
    line(
      procedure.key === "gyro" ? T.calibration.sigma : T.calibration.residual,
      [numeric(Number(v.quality?.toPrecision(3)))],
      procedure.key === "magnetometer" ? T.calibration.of_field : unit
    )
  );
  if (v.temperature > -300) rows.push(line(T.calibration.temperature, [fixed(v.temperature, 1)], "°C"));
  return table(rows);
}

export function calibration_view(ctx, node) {
  const id = node.node,
    cards = h("div", {class: "procedures"}),
    stage = h("div", {class: "stage", hidden: true});
  let active = null,
    view = null,
    last = null,
    poses = null; /* of the mounting */

  const named = (values) => {
    const v = {};
    for (const value of values) {
      const [record, member] = value.name.split(".");
      v[record === "angular_rate" ? `rate_${member}` : member] = value.value;
      if (member === "state" || member === "verdict") v[`${member}_word`] = value.words;
    }
    return v;
  };
  const command = (procedure, word) => ctx.act("write", {node: id, object: `${procedure.record}.command`, value: word});
  const end_poll = () => ctx.bus.request("poll", {node: id, objects: [], hz: 0}).catch(() => {});

  function show_stage(procedure, ...children) {
    stage.hidden = false;
    cards.hidden = true;
    fill(stage, card(T.calibration[procedure.key].title, ...children));
  }
  function show_cards() {
    active = view = last = null;
    end_poll();
    stage.hidden = true;
    cards.hidden = false;
  }
  function run(procedure) {
    active = procedure;
    view = procedure.record ? guide(procedure) : pose_guide();
    if (!procedure.record) view.show("", poses);
    last = RUNNING;
    show_stage(
      procedure,
      h("p", {}, T.calibration[procedure.key].what),
      view.element,
      h(
        "div",
        {class: "actions"},
        button(T.calibration.abort, async () => {
          if (procedure.record) await command(procedure, "abort");
          show_cards();
        })
      )
    );
    ctx.bus
      .request("poll", {node: id, hz: POLL_HZ, objects: procedure.polled})
      .catch((error) => ctx.toast(error.message, "bad"));
  }
  async function start(procedure) {
    poses = new Poses();
    if (!procedure.record || (await command(procedure, procedure.start))) run(procedure);
  }
  /* accept(), discard() promise whether it was done. */
  function offer(procedure, result, accept, discard) {
    const agree = button(
      T.calibration.accept,
      async () => {
        if (!(await accept())) return;
        show_stage(
          procedure,
          h("p", {class: "good", role: "status"}, T.calibration.accepted),
          h(
            "div",
            {class: "actions"},
            button(
              T.calibration.store,
              async () => {
                if (await ctx.act("store", {node: id, group: "all"})) (ctx.toast(T.configuration.stored), show_cards());
              },
              {class: "primary"}
            ),
            button(T.calibration.later, show_cards)
          )
        );
      },
      {class: "primary"}
    );
    show_stage(
      procedure,
      h("p", {class: "good", role: "status"}, T.calibration.result),
      result,
      h(
        "div",
        {class: "actions"},
        agree,
        button(T.calibration.discard, async () => {
          if (await discard()) show_cards();
        })
      )
    );
    agree.focus();
  }
  async function done(procedure) {
    const {values} = await ctx.bus.request("read", {node: id, objects: [procedure.record]});
    offer(
      procedure,
      result_table(procedure, named(values)),
      () => command(procedure, procedure.accept),
      () => command(procedure, procedure.discard)
    );
  }
  async function write_mounting(angles) {
    for (const [i, object] of MOUNTING.entries())
      if (!(await ctx.act("write", {node: id, object, value: angles[i]}))) return false;
    return true;
  }
  function take_pose(procedure, values) {
    const found = new Map(values.map((v) => [v.name, v])),
      numbers = (names) => names.map((name) => found.get(name)?.value);
    const force = numbers(FORCE),
      before = numbers(MOUNTING),
      status = found.get("sample.status")?.words;
    if (!status || ![...force, ...before].every(Number.isFinite)) return;
    view.show(poses.take(force, before, status.includes("rest")), poses);
    if (poses.done.length < 2) return;
    last = DONE;
    end_poll();
    const result = poses.result();
    offer(
      procedure,
      mounting_table(result, before),
      () => write_mounting(result.angles),
      () => true
    );
  }
  function refused(procedure, v) {
    const word = v.verdict_word ?? String(v.verdict);
    show_stage(
      procedure,
      h("p", {class: "error", role: "alert"}, T.calibration.refused(T.calibration.verdicts[word] ?? word)),
      h(
        "div",
        {class: "actions"},
        button(T.calibration.again, () => start(procedure), {class: "primary"}),
        button(T.calibration.back, show_cards)
      )
    );
  }
  const give_up = (error) => {
    ctx.toast(error.message, "bad");
    show_cards();
  };
  const stop_polling = ctx.bus.on("poll", (event) => {
    if (event.node !== id || !active) return;
    if (!active.record) {
      if (last === RUNNING) take_pose(active, event.values);
      return;
    }
    const v = named(event.values),
      state = v.state_word;
    if (state === RUNNING) view.show(v);
    else if (last === RUNNING && state === DONE) (end_poll(), done(active).catch(give_up));
    else if (last === RUNNING && state === REFUSED) (end_poll(), refused(active, v));
    else if (last === RUNNING && state === "idle") show_cards();
    last = state ?? last;
  });
  const stop_open = ctx.bus.on("open", () => active && last === RUNNING && run(active));

  fill(
    cards,
    PROCEDURES.map((procedure) => {
      const text = T.calibration[procedure.key];
      return h(
        "section",
        {class: "card procedure", "aria-label": text.title},
        (procedure.draw ?? (() => side_up(procedure.key === "accelerometer_six" ? 1 : 7, text.drawing)))(),
        h("h2", {}, text.title),
        h("p", {}, text.what),
        h("p", {class: "note"}, text.result),
        button(T.calibration.start, () => start(procedure), {
          class: "primary",
          "data-start": procedure.key,
        })
      );
    })
  );
  /* one that runs already, or waits for an answer */
  (async () => {
    try {
      const {values} = await ctx.bus.request("read", {
        node: id,
        objects: ["calibration.state", "calibration.kind", "lever_arm_identification.state"],
      });
      const word = (name) => values.find((v) => v.name === name)?.words;
      const kind = word("calibration.kind"),
        lever = word("lever_arm_identification.state");
      const found = [RUNNING, DONE].includes(lever)
        ? "lever_arm"
        : [RUNNING, DONE].includes(word("calibration.state"))
          ? kind
          : null;
      const procedure = PROCEDURES.find(({key}) => key === found);
      if (procedure) run(procedure);
    } catch {
      /* shown when it is started */
    }
  })();
  return {
    element: h("div", {class: "stack"}, cards, stage),
    close() {
      stop_polling();
      stop_open();
      end_poll();
    },
  };
}
