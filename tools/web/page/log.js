/* What happened: the node's event log (2131h) and the EMCY messages received. */
import {button, card, fill, h, labelled, say} from "./dom.js";
import {T} from "./strings.js";
import {fixed} from "./text.js";

export function log_view(ctx, node) {
  const emcys = h("ol", {class: "events"}),
    none = h("p", {class: "note"}, T.log.no_emcy);
  function show_emcys() {
    const list = ctx.emcys(node.node);
    none.hidden = list.length > 0;
    fill(
      emcys,
      list.map((emcy) =>
        h("li", {}, h("time", {}, emcy.at.toLocaleTimeString()), h("strong", {}, emcy.code), emcy.text)
      )
    );
  }
  const element = h("div", {class: "stack"}, card(T.log.emcy, none, emcys));
  if (node.ours) {
    const filter = h("input", {type: "search", autocomplete: "off"}),
      list = h("ol", {class: "events"}),
      note = h("p", {class: "note", role: "status"});
    let events = [];
    const show = () => {
      const found = events.filter(({text}) => text.toLowerCase().includes(filter.value.toLowerCase()));
      say(note, T.log.events(found.length));
      fill(
        list,
        found
          .map(({time, text}) =>
            h("li", {}, h("time", {}, typeof time === "number" ? `${fixed(time, 1)} s` : time), text)
          )
          .reverse()
      );
    };
    const load = () =>
      ctx.bus
        .request("events", {node: node.node})
        .then((answer) => {
          events = answer.events;
          show();
        })
        .catch((error) => say(note, error.message));
    filter.addEventListener("input", show);
    element.append(
      card(
        T.log.title,
        h(
          "div",
          {class: "toolbar"},
          labelled(T.log.filter, filter, {class: "grow labelled"}),
          button(T.log.read, load)
        ),
        note,
        list
      )
    );
    load();
  }
  show_emcys();
  const stop = ctx.bus.on("emcy", (event) => event.node === node.node && setTimeout(show_emcys));
  return {element, close: stop};
}
