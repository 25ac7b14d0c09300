/* Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0 */
"use strict";
// Draws the shapes of each .player and moves them with its slider. The data stand in the page as
// JSON; dlo_ros/report/player.py writes them and says what they mean.
(function () {
  const NAMES = ["initial", "observed", "predicted"];
  const ARROWS = ["faint", "arrows"];

  function element(parent, name, attributes) {
    const node = document.createElementNS(parent.namespaceURI, name);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    parent.appendChild(node);
    return node;
  }

  function path(flat) {
    let text = "";
    for (let i = 0; i < flat.length; i += 2) text += (i ? "L" : "M") + flat[i] + " " + flat[i + 1];
    return text;
  }

  // Each arrow is a line x1, y1, x2, y2 with a head; one that is too short to be seen has none.
  function arrows(flat, size) {
    let text = "";
    for (let i = 0; i + 3 < flat.length; i += 4) {
      const [x, y, X, Y] = flat.slice(i, i + 4), length = Math.hypot(X - x, Y - y);
      if (length < size / 4) continue;
      const head = Math.min(size, length / 2), a = (X - x) / length, b = (Y - y) / length;
      text += "M" + x + " " + y + "L" + X + " " + Y;
      for (const side of [0.5, -0.5]) {
        text += "M" + X + " " + Y + "L" + (X - head * (a + side * b)).toFixed(1) + " " +
          (Y - head * (b - side * a)).toFixed(1);
      }
    }
    return text;
  }

  function grid(svg, view) {
    const [x, y, width, height] = view.box;
    const size = Math.max(width, height) / 34;
    for (const at of view.x_ticks) {
      element(svg, "line", {class: "gridline", x1: at, x2: at, y1: y, y2: y + height});
      element(svg, "text", {class: "tick", x: at + size / 4, y: y + height - size / 3,
        "font-size": size}).textContent = at;
    }
    for (const at of view.y_ticks) {
      element(svg, "line", {class: "gridline", x1: x, x2: x + width, y1: -at, y2: -at});
      element(svg, "text", {class: "tick", x: x + size / 4, y: -at - size / 4,
        "font-size": size}).textContent = at;
    }
    element(svg, "text", {class: "tick", x: x + width - size / 2, y: y + 1.4 * size,
      "text-anchor": "end", "font-size": size}).textContent = view.label;
  }

  function build(svg, view) {
    svg.setAttribute("viewBox", view.box.join(" "));
    const parts = {};
    if (view.photograph) {
      const [x, y, width, height] = view.box;
      parts.image = element(svg, "image", {x: x, y: y, width: width, height: height});
    } else {
      grid(svg, view);
      parts.size = Math.max(view.box[2], view.box[3]) / 60;
      for (const name of ARROWS) parts[name] = element(svg, "path", {class: "arrow " + name});
    }
    // Each curve stands out from the photograph; no halo may cover another curve.
    if (view.photograph) {
      for (const name of NAMES) parts[name + "-halo"] = element(svg, "path", {class: "halo"});
    }
    for (const name of NAMES) parts[name] = element(svg, "path", {class: "curve " + name});
    return parts;
  }

  function start(player) {
    const data = JSON.parse(player.querySelector("script").textContent);
    const slider = player.querySelector("input");
    const button = player.querySelector("button");
    const text = player.querySelector("output");
    const drawn = Array.from(player.querySelectorAll(".views svg"),
      (svg, k) => build(svg, data.views[k]));
    let timer = 0;

    function show(index) {
      const frame = data.frames[index];
      slider.value = index;
      drawn.forEach(function (parts, k) {
        if (parts.image) parts.image.setAttribute("href", frame.photograph || "data:,");
        for (const name of NAMES) {
          const d = path((frame.curves[k] || {})[name] || []);
          parts[name].setAttribute("d", d);
          if (parts[name + "-halo"]) parts[name + "-halo"].setAttribute("d", d);
        }
        for (const name of ARROWS) {
          if (!parts[name]) continue;
          parts[name].setAttribute("d", arrows((frame.curves[k] || {})[name] || [], parts.size));
        }
      });
      text.textContent = frame.text;
      slider.setAttribute("aria-valuetext", frame.text);
    }

    function stop() {
      clearInterval(timer);
      timer = 0;
      button.textContent = "Play";
    }

    slider.addEventListener("input", function () { stop(); show(Number(slider.value)); });
    button.addEventListener("click", function () {
      if (timer) return stop();
      button.textContent = "Pause";
      timer = setInterval(function () {
        show((Number(slider.value) + 1) % data.frames.length);
      }, data.interval);
    });
    show(Number(slider.value));
  }

  document.querySelectorAll(".player").forEach(start);
})();
