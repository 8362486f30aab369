/* The view of what a node measures, live. */
import {AttitudeView} from "./attitude.js";
import {button, card, fill, h, list_table, say} from "./dom.js";
import {spectrum} from "./fft.js";
import {colours, on_scheme, Plot} from "./plot.js";
import {Recorder} from "./record.js";
import {Signals} from "./signals.js";
import {T} from "./strings.js";
import {fixed, hex, label_of, numeric, seconds, unit_text} from "./text.js";
import {norm} from "./rotation.js";

const SPAN_S = 10;
const POLL_HZ = 4;
const SCENE_MS = 30;
const CHARTS_MS = 100;
const SEGMENT = 256; /* samples of a segment of the spectrum */
const LIVE_PDOS = [
  /* what "map" adds, to two TPDOs that are free */
  {pdo: 5, entries: ["specific_force16.l", "specific_force16.s", "specific_force16.t", "sample.counter"]},
  {pdo: 6, entries: ["angular_rate16.l", "angular_rate16.s", "angular_rate16.t", "sample.counter"]},
];
const FREE_ID = 0x680,
  PAIRS = 48; /* 680h to 6DFh are free for use in CiA 301: two for each of 48 nodes */
const TPDOS = 8; /* of each node are asked for */
const INVALID = 0x80000000; /* bit 31 of a COB-ID: the PDO does not exist */

/** The CAN-IDs for TPDO5 and 6 of a node: the pair of its node-ID, or else one whose node is not on the bus, from the
 * end. `nodes` are the IDs of all that are, `used` the CAN-IDs that other TPDOs have. null if there is none left. */
export function live_can_ids(node, nodes, used) {
  const pair = (of) => LIVE_PDOS.map((_, i) => FREE_ID + 2 * (of - 1) + i);
  const others = Array.from({length: PAIRS}, (_, i) => PAIRS - i).filter((of) => !nodes.includes(of));
  const own = node <= PAIRS ? [node] : [];
  return [...own, ...others].map(pair).find((ids) => !ids.some((can_id) => used.has(can_id))) ?? null;
}

/** A card with something beside its title. */
function panel(title, body, extra, name) {
  const element = card(title, body);
  if (name) element.classList.add(name);
  if (extra) element.firstChild.append(extra);
  return element;
}

const canvas = (name) => h("div", {class: "plot"}, h("canvas", {role: "img", "aria-label": name}));

/** A row of numbers: [{name, colour}] -> table with value and sigma. */
function readings(names, unit) {
  const cells = names.map(() => h("td", {class: "number"}));
  const sigmas = names.map(() => h("td", {class: "sigma"}));
  const table = h(
    "table",
    {class: "readings"},
    h(
      "tbody",
      {},
      names.map((name, i) =>
        h(
          "tr",
          {},
          h("th", {scope: "row"}, h("span", {class: `axis axis-${i + 1}`}), name),
          cells[i],
          sigmas[i],
          h("td", {class: "unit"}, unit)
        )
      )
    )
  );
  return {
    table,
    show(values, sigma, digits) {
      names.forEach((_, i) => {
        say(cells[i], values ? fixed(values[i], digits) : "–");
        say(sigmas[i], sigma && sigma[i] > 0 ? `± ${fixed(sigma[i], sigma[i] < 100 ? digits : 0)}` : "");
      });
    },
  };
}

export function live_view(ctx, node) {
  return node.ours ? imu_view(ctx, node) : plain_view(ctx, node);
}

/* ---- every device: the values in its PDOs ---------------------------------------------------------------------- */

function plain_view(ctx, node) {
  const body = h("tbody", {});
  const none = h("p", {class: "note"}, T.live.no_pdo_values);
  const recorder = new Recorder(node.node);
  let fields = [],
    cells = [];
  const table = list_table([T.live.pdo, T.live.object, T.live.value, T.live.unit], body);
  const element = h("div", {class: "stack"}, recorder.element, card(T.live.pdo_values, none, table));
  const stop = [
    ctx.bus.on("fields", (event) => {
      if (event.node !== node.node) return;
      fields = event.fields;
      recorder.map(fields);
      cells = fields.map(() => h("td", {class: "number"}, "–"));
      none.hidden = fields.length > 0;
      fill(
        body,
        fields.map((field, i) =>
          h(
            "tr",
            {},
            h("td", {}, `TPDO${field.pdo}`),
            h("td", {}, label_of(field.name)),
            cells[i],
            h("td", {}, unit_text(field.unit))
          )
        )
      );
    }),
    ctx.bus.on("pdo", (event) => {
      if (event.node !== node.node) return;
      recorder.rows(event.rows);
      for (const row of event.rows)
        cells.forEach((cell, i) => row[i + 1] !== null && row[i + 1] !== undefined && say(cell, numeric(row[i + 1])));
    }),
  ];
  const subscribe = () => ctx.bus.request("subscribe", {node: node.node, hz: 20}).catch(() => {});
  stop.push(ctx.bus.on("open", subscribe));
  subscribe();
  return {
    element,
    close() {
      stop.forEach((f) => f());
      ctx.bus.request("unsubscribe", {node: node.node}).catch(() => {});
    },
  };
}

/* ---- an IMU ----------------------------------------------------------------------------------------------------- */

function imu_view(ctx, node) {
  const id = node.node,
    signals = new Signals(),
    recorder = new Recorder(id);
  const facts = {};
  const tile = (key, text) =>
    h("div", {class: "fact"}, h("dt", {}, text), (facts[key] = h("dd", {"data-fact": key}, "–")));
  const hint = h("div", {class: "hint", hidden: true});
  const status = h("ul", {class: "chips", "aria-label": T.live.status});
  const angles = readings(
    ["roll", "pitch", "yaw"].map((a) => T.live[a]),
    "°"
  );
  const acceleration = readings(["l", "s", "t"], "m/s²"),
    rate = readings(["l", "s", "t"], "°/s");
  const position = readings(["x", "y", "z"], "m");
  angles.table.dataset.signal = "angles";
  acceleration.table.dataset.signal = "acceleration";
  position.table.dataset.signal = "position";
  rate.table.dataset.signal = "rate";
  const before = h("input", {type: "checkbox", id: "show-before", checked: true});
  const rms = h("p", {class: "note", "data-fact": "rms"});
  const spectrum_note = h("p", {class: "note"});
  const scene = h("canvas", {class: "scene", tabindex: 0, role: "img", "aria-label": T.live.scene});
  const areas = Object.fromEntries(
    ["acceleration", "rate", "position", "trajectory", "spectrum"].map((name) => [name, canvas(T.live[name])])
  );

  const element = h(
    "div",
    {class: "stack"},
    hint,
    h(
      "div",
      {class: "live"},
      panel(
        T.live.attitude,
        h("div", {class: "attitude"}, scene, angles.table),
        h("span", {class: "note wide-only"}, T.live.drag),
        "tall"
      ),
      panel(
        T.live.acceleration,
        h("div", {class: "chart"}, areas.acceleration, acceleration.table, rms),
        h("span", {class: "check"}, before, h("label", {for: "show-before"}, T.live.show_before))
      ),
      panel(
        T.live.state,
        h(
          "div",
          {},
          h(
            "dl",
            {class: "facts"},
            tile("pdo_rate", T.live.pdo_rate),
            tile("age", T.live.age),
            tile("sample_age", T.live.sample_age),
            tile("sensor_rate", T.live.sensor_rate),
            tile("skipped", T.live.skipped),
            tile("vibration", T.live.vibration),
            tile("temperature", T.live.temperature)
          ),
          status
        ),
        recorder.element
      ),
      panel(T.live.rate, h("div", {class: "chart"}, areas.rate, rate.table)),
      panel(
        T.live.position,
        h("div", {class: "chart"}, areas.position, position.table),
        button(T.live.zero, () => ctx.act("write", {node: id, object: "position.reset", value: 1}))
      ),
      panel(
        T.live.trajectory,
        h("div", {class: "chart"}, areas.trajectory),
        button(T.live.clear, () => signals.series.position.clear())
      ),
      panel(T.live.spectrum, h("div", {class: "chart"}, areas.spectrum, spectrum_note))
    )
  );

  /* -- charts: made when Chart.js is there; the rest works without it */
  const plots = {};
  const attitude = new AttitudeView(scene, {north: "N", east: "E", south: "S", west: "W", arm: T.live.arm});
  const time = {title: T.live.time_axis, min: -SPAN_S, max: 0};
  function make_plots() {
    const of = (name, options) => (plots[name] = new Plot(areas[name].firstChild, options));
    const lines = (names) => names.map((label, colour) => ({label, colour}));
    const band = (name, colour) => [
      {label: name, colour},
      {label: "", colour, bare: true},
      {label: "", colour, fill: "-1"},
    ];
    of("acceleration", {
      lines: [
        ...lines(["l", "s", "t"]),
        ...["l", "s", "t"].map((axis, colour) => ({
          label: T.live.before(axis),
          colour,
          dash: true,
        })),
      ],
      x: time,
      y: {title: "m/s²"},
    });
    of("rate", {lines: lines(["l", "s", "t"]), x: time, y: {title: "°/s"}});
    of("position", {lines: ["x", "y", "z"].flatMap(band), x: time, y: {title: "m"}});
    of("trajectory", {
      lines: [{label: "", colour: 2}],
      x: {title: T.live.east_axis},
      y: {title: T.live.north_axis},
      legend: false,
    });
    of("spectrum", {
      lines: lines(["l", "s", "t"]),
      x: {title: "Hz", min: 0},
      y: {
        title: "m/s²/√Hz",
        type: "logarithmic",
        ticks: {callback: (v) => (Math.log10(v) % 1 ? "" : v.toPrecision(1))},
      },
    });
  }
  function paint() {
    attitude.colours = colours();
    Object.values(plots).forEach((plot) => plot.paint());
  }

  /* -- data */
  let words = {},
    poll = "",
    scene_ms = 0,
    charts_ms = 0,
    frame = 0,
    running = true,
    counted = {at: 0, rows: 0};
  function ask() {
    const objects = signals.missing(),
      text = objects.join();
    if (text === poll || !ctx.bus.open || ctx.lost(id)) return;
    poll = text;
    ctx.bus.request("poll", {node: id, objects, hz: POLL_HZ}).catch(() => (poll = ""));
  }
  async function subscribe() {
    poll = "";
    try {
      const known = await ctx.bus.request("read", {node: id, objects: ["gravity", "lever_arm"]});
      for (const {name, value} of known.values) {
        if (name === "gravity") signals.gravity = value;
        const axis = ["lever_arm.l", "lever_arm.s", "lever_arm.t"].indexOf(name);
        if (axis >= 0) attitude.arm_m[axis] = value;
      }
      words = (await ctx.objects(id)).by_name.get("sample.status")?.bits ?? {};
      await ctx.bus.request("subscribe", {node: id, hz: 20});
    } catch {
      /* it is asked again when the node is heard */
    }
    ask();
  }
  const stop = [
    ctx.bus.on("fields", (event) => event.node === id && (signals.map(event.fields), recorder.map(event.fields))),
    ctx.bus.on("pdo", (event) => {
      if (event.node === id) (signals.rows(event.rows, event.lost), recorder.rows(event.rows));
    }),
    ctx.bus.on("poll", (event) => event.node === id && signals.polled(event.values)),
    ctx.bus.on("open", subscribe),
    on_scheme(paint),
  ];

  /* -- what is shown */
  const tidy = (value) => Number(value.toPrecision(3));
  const point = (series, column, now) => signals.series[series].points(column, now, SPAN_S);
  function draw_plots(now) {
    const three = (series, k = 1) => [0, 1, 2].map((i) => point(series, i, now).map(({x, y}) => ({x, y: k * y})));
    plots.acceleration.show([...three("acceleration"), ...(before.checked ? three("before") : [])]);
    plots.rate.show(three("rate", 180 / Math.PI));
    const sigma = signals.series.position_sigma.latest() ?? [0, 0, 0];
    const way = three("position"),
      all = way
        .flat()
        .map(({y}) => y)
        .filter(Number.isFinite);
    const low = Math.min(...all),
      high = Math.max(...all);
    /* the band is cut off where it would make the lines flat */
    const room = Math.min(Math.max(...sigma, 0.02), 2 * Math.max(high - low, 0.2)) * 1.15;
    plots.position.show(
      way.flatMap((line, i) => [
        line,
        line.map(({x, y}) => ({x, y: y - sigma[i]})),
        line.map(({x, y}) => ({x, y: y + sigma[i]})),
      ]),
      all.length ? {y: {min: tidy(low - room), max: tidy(high + room)}} : {}
    );
    draw_trajectory();
    draw_spectrum();
  }
  function draw_trajectory() {
    const position = signals.series.position,
      step = Math.max(1, Math.floor(position.count / 600)),
      path = [];
    for (let age = position.count - 1; age >= 0; age -= step) {
      const at = position.at(age);
      path.push({x: position.columns[0][at], y: position.columns[1][at]});
    }
    if (!path.length) return plots.trajectory.show([[]]);
    const range = (axis) =>
      path.reduce(([low, high], p) => [Math.min(low, p[axis]), Math.max(high, p[axis])], [Infinity, -Infinity]);
    const [xl, xh] = range("x"),
      [yl, yh] = range("y"),
      aspect = plots.trajectory.aspect();
    /* one scale for both axes, at least half a metre */
    const half = 0.55 * Math.max(0.5, yh - yl, (xh - xl) / aspect);
    return plots.trajectory.show([path], {
      x: {min: tidy((xl + xh) / 2 - half * aspect), max: tidy((xl + xh) / 2 + half * aspect)},
      y: {min: tidy((yl + yh) / 2 - half), max: tidy((yl + yh) / 2 + half)},
    });
  }
  function draw_spectrum() {
    const series = signals.series.vibration,
      ready = series.count >= SEGMENT && signals.rate_hz > 0;
    const hz =
      signals.state["sensor_state.rate"] > 0 && signals.counter_column
        ? signals.state["sensor_state.rate"]
        : signals.rate_hz;
    say(
      spectrum_note,
      ready
        ? T.live.spectrum_of(signals.columns.force ? T.live.force : T.live.corrected, hz)
        : T.live.spectrum_needs(SEGMENT, series.count)
    );
    if (!ready) return plots.spectrum.show([]);
    return plots.spectrum.show(
      [0, 1, 2].map((i) => {
        const found = spectrum(series.tail(i, 2048), hz, SEGMENT);
        return found.hz.map((x, k) => ({x, y: Math.max(found.density[k], 1e-6)}));
      }),
      {x: {max: hz / 2}}
    );
  }
  function root_mean_square(series) {
    const s = signals.series[series],
      now = signals.now_s();
    let n = 0,
      sum = 0;
    while (n < s.count && s.t[s.at(n)] > now - SPAN_S) {
      const i = s.at(n++);
      sum += s.columns.reduce((square, column) => square + column[i] * column[i], 0);
    }
    return n > 4 ? Math.sqrt(sum / n) : NaN;
  }
  function draw_numbers() {
    const s = signals.series,
      latest = (name) => s[name].latest(),
      state = signals.state;
    angles.show(latest("angles"), latest("attitude_sigma"), 2);
    acceleration.show(latest("acceleration"), null, 3);
    rate.show(
      latest("rate")?.map((v) => (v * 180) / Math.PI),
      null,
      2
    );
    position.show(latest("position"), latest("position_sigma"), 3);
    const after = root_mean_square("acceleration"),
      earlier = root_mean_square("before");
    say(rms, after > 0 ? T.live.rms(fixed(after, 3), earlier > 0 ? fixed(earlier, 3) : null) : "");
    rms.dataset.after = after || "";
    rms.dataset.before = earlier || "";
    const now = performance.now() / 1000;
    if (now - counted.at >= 2) {
      counted.hz = counted.at ? (signals.counts.rows - counted.rows) / (now - counted.at) : NaN;
      counted = {at: now, rows: signals.counts.rows, hz: counted.hz};
    }
    say(facts.pdo_rate, signals.fresh() && counted.hz > 0 ? T.live.per_second(fixed(counted.hz, 0)) : T.live.none);
    say(facts.age, Number.isFinite(signals.last_row_s) ? seconds(now - signals.last_row_s) : "–");
    const known = (name, unit, digits) =>
      typeof state[name] === "number" && state[name] > -300 ? `${fixed(state[name], digits)} ${unit}` : "–";
    const ages_ms = ["minimum", "maximum"].map((member) => state[`sample_age.${member}`] / 1000);
    say(facts.sample_age, ages_ms[1] > 0 ? T.live.ages(...ages_ms.map((ms) => fixed(ms, 1))) : "–");
    say(facts.sensor_rate, known("sensor_state.rate", "Hz", 1));
    say(facts.temperature, known("sensor_state.temperature", "°C", 1));
    say(facts.vibration, known("sensor_state.vibration", "m/s²", 3));
    say(facts.skipped, T.live.skips(signals.counts.skipped, signals.counts.lost));
    const bits = state["sample.status"] ?? 0,
      chips = Object.entries(words).filter(([bit]) => (bits >> bit) & 1);
    const shown = chips.map(([, word]) => word).join();
    if (status.dataset.shown !== shown) {
      status.dataset.shown = shown;
      fill(
        status,
        chips.map(([, word]) =>
          h(
            "li",
            {
              class: `chip ${
                T.live.good_status.includes(word) ? "good" : T.live.bad_status.includes(word) ? "bad" : ""
              }`,
            },
            T.live.status_words[word] ?? label_of(word)
          )
        )
      );
    }
  }
  /* What the TPDOs of all nodes have, but for the two that are mapped. A lost node does not answer. */
  async function used_can_ids() {
    const used = new Set(),
      own = LIVE_PDOS.map(({pdo}) => pdo);
    for (const {node} of ctx.nodes().filter((other) => !ctx.lost(other.node))) {
      const pdos = Array.from({length: TPDOS}, (_, i) => i + 1).filter((pdo) => node !== id || !own.includes(pdo));
      const objects = pdos.map((pdo) => `${hex(0x1800 + pdo - 1, 4)}:01`);
      const {values} = await ctx.bus.request("read", {node, objects}).catch(() => ({values: []}));
      for (const {value} of values) if (value < INVALID) used.add(value & 0x7ff);
    }
    return used;
  }
  async function map_live() {
    const nodes = ctx.nodes().map(({node}) => node),
      can_ids = live_can_ids(id, nodes, await used_can_ids());
    if (!can_ids) return ctx.toast(T.live.no_can_ids);
    for (const [i, {pdo, entries}] of LIVE_PDOS.entries())
      if (
        !(await ctx.act("set_mapping", {
          node: id,
          pdo,
          type: 1,
          entries,
          inhibit: 0,
          event_timer: 0,
          cob_id: can_ids[i],
        }))
      )
        return undefined;
    return ctx.toast(T.live.mapped);
  }
  function draw_hint() {
    const now = ctx.node(id),
      ways = [];
    if (now?.state === "pre-operational" || now?.state === "stopped")
      ways.push([
        T.live.hint_state(T.states[now.state]),
        [T.nmt.start, () => ctx.act("nmt", {node: id, command: "start"})],
      ]);
    else if (now?.state === "operational" && !signals.fresh() && !ctx.sync_hz())
      ways.push([T.live.hint_sync, [T.live.produce_sync, () => ctx.act("sync", {hz: 100})]]);
    else if (
      now?.state === "operational" &&
      signals.fresh() &&
      signals.fields.length &&
      (!signals.columns.force || !signals.columns.rate)
    )
      ways.push([T.live.hint_map, [T.live.map, map_live]]);
    const text = ways.map(([sentence]) => sentence).join();
    if (hint.dataset.shown === text) return;
    hint.dataset.shown = text;
    hint.classList.toggle("info", signals.fresh());
    hint.hidden = !ways.length;
    fill(
      hint,
      ways.map(([sentence, [name, f]]) => [h("p", {}, sentence), button(name, f)])
    );
  }
  function draw(at_ms) {
    if (!running) return;
    frame = requestAnimationFrame(draw);
    if (at_ms < scene_ms) return;
    scene_ms = at_ms + SCENE_MS;
    attitude.stale = ctx.lost(id);
    attitude.r = signals.attitude;
    attitude.draw();
    if (at_ms < charts_ms) return;
    const began_ms = performance.now();
    ask();
    draw_hint();
    draw_numbers();
    if (plots.acceleration && !ctx.lost(id)) draw_plots(signals.now_s());
    /* on a slow machine less often, so that there is time for all else */
    charts_ms = at_ms + Math.max(CHARTS_MS, 4 * (performance.now() - began_ms));
  }

  subscribe();
  paint();
  ctx.charts().then(() => running && (make_plots(), paint()));
  frame = requestAnimationFrame(draw);
  return {
    element,
    changed() {
      poll = "";
      if (signals.last_row_s === -Infinity || !signals.fresh()) subscribe();
    },
    close() {
      running = false;
      cancelAnimationFrame(frame);
      stop.forEach((f) => f());
      Object.values(plots).forEach((plot) => plot.close());
      ctx.bus.request("unsubscribe", {node: id}).catch(() => {});
      ctx.bus.request("poll", {node: id, objects: [], hz: 0}).catch(() => {});
    },
  };
}
