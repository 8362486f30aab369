/* The page: header, list of nodes, the view chosen by the address (#/node/5/objects), unlocking, messages. */
import {bus_view} from "./bus.js";
import {calibration_view} from "./calibration.js";
import {configuration_view} from "./configuration.js";
import {Connection} from "./connection.js";
import {button, fill, h, labelled, say} from "./dom.js";
import {live_view} from "./live.js";
import {log_view} from "./log.js";
import {objects_view} from "./objects.js";
import {pdo_view} from "./pdo.js";
import {T} from "./strings.js";
import {fixed, hex, seconds} from "./text.js";

const TOAST_MS = 6000;
const EMCYS = 200; /* kept */
const VIEWS = {
  live: live_view,
  objects: objects_view,
  calibration: calibration_view,
  pdos: pdo_view,
  configuration: configuration_view,
  log: log_view,
};
const OURS_ONLY = ["calibration"];

const $ = (name) => document.getElementById(name);
const bus = new Connection(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
let nodes = [],
  nodes_at_s = 0,
  unlocked = false,
  token = null,
  sync_hz = null,
  shown = null;
const emcys = [],
  known_objects = new Map();
const now_s = () => performance.now() / 1000;

/* ---- what the views share ---------------------------------------------------------------------------------------- */

const ctx = {
  bus,
  nodes: () => nodes,
  node: (id) => nodes.find((node) => node.node === id),
  lost: (id) => !bus.open || ctx.node(id)?.state === "lost",
  heard_s: (node) => (node.heard_s ?? NaN) + now_s() - nodes_at_s,
  sync_hz: () => sync_hz,
  emcys: (id) => emcys.filter((emcy) => emcy.node === id),
  toast,
  confirm: ask,
  /** The objects of a node: {list, by_name}. */
  objects(id) {
    const node = ctx.node(id),
      key = [id, node?.vendor, node?.product, node?.revision].join();
    if (!known_objects.has(key)) {
      const found = bus.request("objects", {node: id}).then(({objects}) => ({
        list: objects,
        by_name: new Map(objects.map((object) => [object.name, object])),
      }));
      found.catch(() => known_objects.delete(key));
      known_objects.set(key, found);
    }
    return known_objects.get(key);
  },
  /** A request that changes something: asks for the token if need be. Promises the result, or null after
   * telling why. */
  async act(op, fields, tell = (error) => toast(error.message, "bad")) {
    for (;;) {
      try {
        return (await bus.request(op, fields)) ?? {};
      } catch (error) {
        if (!error.locked) {
          tell(error);
          return null;
        }
        show_unlocked(false);
        if (!(await ask_token())) return null;
      }
    }
  },
  charts,
};

let chart_script = null;
/** Promises that Chart.js is there. */
function charts() {
  chart_script ??= new Promise((done, fail) => {
    const script = h("script", {src: "/chart.min.js"});
    script.onload = done;
    script.onerror = () => fail(new Error("chart.min.js"));
    document.head.append(script);
  });
  return chart_script;
}

function toast(text, kind = "good") {
  const message = h(
    "div",
    {class: `toast ${kind}`, role: kind === "bad" ? "alert" : "status"},
    h("span", {class: "grow"}, text),
    button("×", () => message.remove(), {class: "icon", "aria-label": T.close})
  );
  $("toasts").append(message);
  setTimeout(() => message.remove(), TOAST_MS);
}

/* ---- dialogues --------------------------------------------------------------------------------------------- */

function dialogue(title, body, actions) {
  return new Promise((done) => {
    const box = h("dialog", {"aria-labelledby": "dialogue-title"});
    const heading = h("h2", {id: "dialogue-title"}, title);
    fill(box, h("form", {method: "dialog"}, heading, body, h("div", {class: "actions"}, actions(box))));
    box.addEventListener("close", () => {
      done(box.returnValue);
      box.remove();
    });
    document.body.append(box);
    box.showModal();
  });
}

/** Promises whether the answer was yes. */
async function ask(text, yes) {
  return (
    (await dialogue(yes, h("p", {}, text), () => [
      h("button", {value: "yes", class: "danger"}, yes),
      h("button", {value: ""}, T.cancel),
    ])) === "yes"
  );
}

let asking = null;
/** Promises whether the page is unlocked then. */
function ask_token() {
  asking ??= (async () => {
    const input = h("input", {type: "password", autocomplete: "off", required: true, id: "token"});
    const note = h("p", {class: "error", role: "alert"});
    let ok = false;
    const answer = dialogue(
      T.unlock.title,
      h("div", {}, h("p", {}, T.unlock.text), labelled(T.unlock.token, input), note),
      (box) => [
        h(
          "button",
          {
            class: "primary",
            type: "submit",
            onclick: async (event) => {
              event.preventDefault();
              say(note, "");
              try {
                await unlock(input.value.trim());
                ok = true;
                box.close();
              } catch (error) {
                say(note, error.message);
                input.select();
              }
            },
          },
          T.unlock.action
        ),
        button(T.cancel, () => box.close()),
      ]
    );
    await answer;
    asking = null;
    return ok;
  })();
  return asking;
}

async function unlock(text) {
  await bus.request("unlock", {token: text});
  token = text;
  show_unlocked(true);
}

function show_unlocked(is) {
  unlocked = is;
  const lock = $("lock");
  lock.classList.toggle("open", is);
  say(lock, is ? T.unlock.open : T.unlock.locked);
  lock.title = is ? T.unlock.open_text : T.unlock.locked_text;
}

/** The token of an address #token=.., which is removed from it, so that it stays in no history and no bookmark. */
function token_of_address() {
  const found = /(?:^#|&)token=([^&]*)/.exec(location.hash);
  if (!found) return;
  token = decodeURIComponent(found[1]);
  history.replaceState(null, "", location.pathname + location.search);
}

/* ---- nodes ------------------------------------------------------------------------------------------------------- */

function node_link(node) {
  const view = shown?.view && shown.view !== "bus" ? shown.view : "live";
  const state = h("span", {class: `state state-${node.state}`}, T.states[node.state] ?? node.state);
  const age = h("span", {class: "age"});
  return {
    node,
    state,
    age,
    element: h(
      "li",
      {},
      h(
        "a",
        {href: `#/node/${node.node}/${view}`, class: "node-link", "data-node": node.node},
        h("span", {class: "id"}, String(node.node)),
        h(
          "span",
          {class: "grow"},
          h("span", {class: "name"}, node.name || T.bus.unnamed),
          h("span", {class: "row"}, state, age)
        )
      )
    ),
  };
}

let links = [];
function show_nodes() {
  const key = JSON.stringify(nodes.map((node) => [node.node, node.name, node.state]));
  if ($("nodes").dataset.shown !== key) {
    $("nodes").dataset.shown = key;
    const focused = $("nodes").contains(document.activeElement) && document.activeElement.dataset.node;
    links = nodes.map(node_link);
    fill(
      $("nodes"),
      links.map((link) => link.element)
    );
    if (focused) $("nodes").querySelector(`[data-node="${focused}"]`)?.focus();
    $("no-nodes").hidden = nodes.length > 0;
  }
  mark_links();
  show_ages();
}

function mark_links() {
  for (const link of document.querySelectorAll("[data-node], #bus-link")) {
    const on = link.id === "bus-link" ? shown?.view === "bus" : shown?.node === Number(link.dataset.node);
    link.toggleAttribute("aria-current", on);
    if (on) link.setAttribute("aria-current", "page");
    if (link.dataset.node) {
      link.classList.toggle("lost", ctx.lost(Number(link.dataset.node)));
      if (shown?.view && shown.view !== "bus") link.href = `#/node/${link.dataset.node}/${shown.view}`;
    }
  }
}

function show_ages() {
  for (const {node, age} of links) {
    const is = ctx.node(node.node);
    say(age, is && is.state === "lost" ? T.ago(seconds(ctx.heard_s(is))) : "");
  }
  if (shown?.node) show_head();
}

/* ---- the view ---------------------------------------------------------------------------------------------------- */

function route() {
  const [, node, view] = /^#\/node\/(\d+)(?:\/(\w+))?/.exec(location.hash) ?? [];
  if (node) return {node: Number(node), view: VIEWS[view] ? view : "live"};
  return /^#\/bus/.test(location.hash)
    ? {view: "bus"}
    : nodes.length
      ? {node: nodes[0].node, view: "live"}
      : {view: "bus"};
}

function show_head() {
  const node = ctx.node(shown.node),
    lost = ctx.lost(shown.node);
  say($("node-name"), node?.name || T.bus.node_title(shown.node));
  say(
    $("node-facts"),
    [T.bus.node_title(shown.node), typeof node?.serial === "number" ? T.bus.serial_of(hex(node.serial, 8)) : ""]
      .filter(Boolean)
      .join(" · ")
  );
  const state = lost ? "lost" : (node?.state ?? "unknown");
  $("node-state").className = `state state-${state}`;
  say($("node-state"), T.states[state] ?? state);
  $("main").classList.toggle("is-lost", lost);
  $("lost").hidden = !lost;
  say($("lost-text"), lost ? (bus.open ? T.lost : T.no_server) : "");
  say($("lost-age"), lost && node && bus.open ? T.last_heard(seconds(ctx.heard_s(node))) : "");
  const emcy = ctx.emcys(shown.node)[0],
    active = emcy && emcy.code !== "0000h" && !emcy.seen;
  $("emcy").hidden = !active;
  say($("emcy-text"), active ? T.emcy(emcy.code, emcy.text) : "");
}

function show_view() {
  const wanted = route(),
    node = ctx.node(wanted.node) ?? {node: wanted.node, ours: false, state: "unknown"};
  const next = {
    node: wanted.node,
    ours: node.ours,
    view: OURS_ONLY.includes(wanted.view) && !node.ours ? "live" : wanted.view,
  };
  if (shown && shown.view === next.view && shown.node === next.node && shown.ours === next.ours) return;
  shown?.content?.close();
  shown = next;
  $("main").classList.remove("is-lost");
  $("node-head").hidden = shown.view === "bus";
  $("bus-head").hidden = shown.view !== "bus";
  shown.content = shown.view === "bus" ? bus_view(ctx) : VIEWS[shown.view](ctx, node);
  fill($("view"), shown.content.element);
  const tabs = Object.keys(VIEWS).filter((view) => node.ours || !OURS_ONLY.includes(view));
  fill(
    $("tabs"),
    tabs.map((view) =>
      h(
        "a",
        {
          role: "tab",
          href: `#/node/${shown.node}/${view}`,
          id: `tab-${view}`,
          "aria-selected": String(view === shown.view),
          tabindex: view === shown.view ? 0 : -1,
          "aria-controls": "view",
        },
        T.tabs[view]
      )
    )
  );
  $("view").setAttribute("aria-labelledby", shown.view === "bus" ? "bus-title" : `tab-${shown.view}`);
  document.title =
    shown.view === "bus" ? T.title : `${T.bus.node_title(shown.node)} · ${T.tabs[shown.view]} · ${T.title}`;
  if (shown.node) {
    $("emcy").hidden = true;
    show_head();
    $(`tab-${shown.view}`)?.scrollIntoView({block: "nearest", inline: "center"});
  }
  mark_links();
}

function tab_keys(event) {
  const tabs = [...$("tabs").children],
    at = tabs.indexOf(document.activeElement);
  const to = {ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: tabs.length - 1}[event.key];
  if (at < 0 || to === undefined) return;
  event.preventDefault();
  const tab = tabs[(to + tabs.length) % tabs.length];
  location.hash = tab.getAttribute("href");
  show_view();
  $(tab.id).focus();
}

/* ---- events ------------------------------------------------------------------------------------------------------ */

function hello(event) {
  say($("bus-name"), event.bus ?? "");
  say($("version"), [event.program, event.version].filter(Boolean).join(" "));
  show_unlocked(event.unlocked === true);
  if (token && !event.unlocked)
    unlock(token).catch((error) => {
      token = null;
      toast(error.message, "bad");
    });
}

function start() {
  token_of_address();
  for (const element of document.querySelectorAll("[data-text]"))
    say(
      element,
      element.dataset.text.split(".").reduce((texts, key) => texts[key], T)
    );
  for (const element of document.querySelectorAll("[data-label]"))
    element.setAttribute(
      "aria-label",
      element.dataset.label.split(".").reduce((texts, key) => texts[key], T)
    );
  show_unlocked(false);
  fill(
    $("nmt"),
    ["start", "preop", "stop", "reset"].map((command) =>
      button(T.nmt[command], () => shown?.node && ctx.act("nmt", {node: shown.node, command}), {
        "data-nmt": command,
        title: T.nmt.titles[command],
      })
    )
  );
  $("lock").addEventListener("click", () => unlocked || ask_token());
  $("emcy-seen").addEventListener("click", () => {
    ctx.emcys(shown.node).forEach((emcy) => (emcy.seen = true));
    show_head();
  });
  $("tabs").addEventListener("keydown", tab_keys);
  addEventListener("hashchange", show_view);

  bus.on("open", () => {
    say($("connection"), "");
    document.body.classList.remove("offline");
  });
  bus.on("close", () => {
    say($("connection"), T.no_server);
    document.body.classList.add("offline");
    show_nodes();
  });
  bus.on("hello", hello);
  bus.on("nodes", (event) => {
    const was = shown?.node && ctx.node(shown.node)?.state;
    nodes = event.nodes;
    nodes_at_s = now_s();
    show_view();
    show_nodes();
    if (shown?.content?.changed && (!shown.node || was !== ctx.node(shown.node)?.state))
      shown.content.changed(ctx.node(shown.node));
  });
  bus.on("bus", (event) => {
    sync_hz = event.sync_hz > 0 ? event.sync_hz : 0;
    say($("load"), typeof event.load === "number" ? T.load(fixed(100 * event.load, 0)) : T.load_unknown);
    say($("frames"), T.frames(fixed(event.frames_hz, 0)));
    say($("sync"), sync_hz ? T.sync(fixed(sync_hz, 0)) : T.no_sync);
  });
  bus.on("emcy", (event) => {
    emcys.unshift({...event, at: new Date()});
    emcys.length = Math.min(emcys.length, EMCYS);
    say($("announce"), T.emcy_of(event.node, event.code, event.text));
    if (shown?.node === event.node) show_head();
    else if (event.code !== "0000h") toast(T.emcy_of(event.node, event.code, event.text), "bad");
  });
  setInterval(show_ages, 500);
  bus.connect();
}

start();
