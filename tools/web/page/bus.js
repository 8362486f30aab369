/* The bus: all nodes, NMT, SYNC, and units without a node-ID (LSS). */
import {button, card, fill, h, labelled, list_table, say} from "./dom.js";
import {T} from "./strings.js";
import {hex, numeric, seconds} from "./text.js";

export function bus_view(ctx) {
  const rows = h("tbody", {}),
    none = h("p", {class: "note"}, T.bus.none);
  const scan = button(T.bus.scan, async () => {
    scan.disabled = true;
    say(scan, T.bus.scanning);
    try {
      await ctx.bus.request("scan");
    } catch (error) {
      ctx.toast(error.message, "bad");
    }
    scan.disabled = false;
    say(scan, T.bus.scan);
  });
  function show() {
    const nodes = ctx.nodes();
    none.hidden = nodes.length > 0;
    fill(
      rows,
      nodes.map((node) =>
        h(
          "tr",
          {class: node.state === "lost" ? "lost" : ""},
          h("th", {scope: "row"}, h("a", {href: `#/node/${node.node}`}, `${node.node}`)),
          h("td", {}, node.name || "–"),
          h("td", {}, h("span", {class: `state state-${node.state}`}, T.states[node.state] ?? node.state)),
          h("td", {class: "number"}, typeof node.serial === "number" ? hex(node.serial, 8) : "–"),
          h("td", {class: "number"}, seconds(ctx.heard_s(node)))
        )
      )
    );
  }
  const nmt = (command) =>
    button(T.nmt[command], () => ctx.act("nmt", {node: 0, command}), {title: T.nmt.titles[command]});
  const nodes = card(
    T.bus.nodes,
    list_table([T.bus.node, T.bus.name, T.bus.state, T.bus.serial, T.bus.heard], rows),
    none,
    h("div", {class: "actions"}, scan, ["start", "preop", "stop", "reset"].map(nmt)),
    h("p", {class: "note"}, T.bus.all_note)
  );

  /* -- SYNC */
  const hz = h("input", {type: "number", min: 1, max: 1000, value: 100});
  const heard = h("p", {class: "note", role: "status"});
  const sync = card(
    T.bus.sync,
    h("p", {}, T.bus.sync_text),
    h(
      "div",
      {class: "toolbar"},
      labelled(T.bus.rate, hz, {class: "grow labelled"}),
      button(T.bus.produce, () => ctx.act("sync", {hz: Number(hz.value)}), {class: "primary"}),
      button(T.bus.silence, () => ctx.act("sync", {hz: 0}))
    ),
    heard
  );

  /* -- LSS */
  const units = h("div", {}),
    lss_note = h("p", {class: "note", role: "status"});
  function unit_row(unit) {
    const free = Array.from({length: 127}, (_, i) => i + 1).find((n) => !ctx.node(n)) ?? 1;
    const id = h("input", {type: "number", min: 1, max: 127, value: free});
    return h(
      "li",
      {class: "unit-row"},
      h(
        "div",
        {class: "grow"},
        h("strong", {}, T.bus.unit(hex(unit.serial, 8))),
        h("p", {class: "note"}, T.bus.identity(hex(unit.vendor, 8), numeric(unit.product), hex(unit.revision, 8)))
      ),
      labelled(T.bus.new_id, id),
      button(
        T.bus.set_id,
        async () => {
          const node = Number(id.value);
          if (!(node >= 1 && node <= 127)) return say(lss_note, T.bus.id_wrong);
          if (await ctx.act("lss", {command: "set", identity: unit, node}, (error) => say(lss_note, error.message)))
            (say(lss_note, T.bus.named(node)), fill(units));
          return undefined;
        },
        {class: "primary"}
      )
    );
  }
  const find = button(T.bus.find, async () => {
    find.disabled = true;
    say(lss_note, T.bus.finding);
    const found = await ctx.act("lss", {command: "find"}, (error) => say(lss_note, error.message));
    find.disabled = false;
    if (!found) return;
    say(lss_note, T.bus.found(found.units.length));
    fill(units, h("ul", {class: "units"}, found.units.map(unit_row)));
  });
  const lss = card(T.bus.lss, h("p", {}, T.bus.lss_text), h("div", {class: "actions"}, find), lss_note, units);

  nodes.classList.add("wide", "nodes");
  show();
  const timer = setInterval(show, 1000);
  const stop = ctx.bus.on("bus", (event) =>
    say(heard, event.sync_hz > 0 ? T.bus.sync_heard(event.sync_hz) : T.bus.no_sync)
  );
  return {
    element: h("div", {class: "stack columns"}, nodes, sync, lss),
    changed: show,
    close() {
      clearInterval(timer);
      stop();
    },
  };
}
