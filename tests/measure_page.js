// Measures a page at several widths, each in a frame of its own, and drawings by themselves.

const SLACK = 1.5; // pixels that letters may share

function corners(box, matrix) {
  return [[0, 0], [1, 0], [1, 1], [0, 1]].map(([a, b]) => {
    const p = new DOMPoint(box.x + a * box.width, box.y + b * box.height);
    const q = matrix ? p.matrixTransform(matrix) : p;
    return [q.x, q.y];
  });
}

// Whether two convex shapes share more than the slack, along every direction of their edges.
function overlap(first, second) {
  for (const shape of [first, second]) {
    for (let i = 0; i < 2; i++) {
      const [dx, dy] = [shape[i + 1][0] - shape[i][0], shape[i + 1][1] - shape[i][1]];
      const length = Math.hypot(dx, dy) || 1;
      const [a, b] = [first, second].map((s) => s.map(([x, y]) => (x * dx + y * dy) / length));
      const shared = Math.min(Math.max(...a), Math.max(...b)) - Math.max(Math.min(...a), Math.min(...b));
      if (shared < SLACK) return false;
    }
  }
  return true;
}

function overlapping(texts) {
  const found = [];
  texts.forEach(([name, shape], i) => {
    for (const [other, there] of texts.slice(i + 1)) {
      if (overlap(shape, there)) found.push(`${name} | ${other}`);
    }
  });
  return found;
}

function lines(document) {
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const range = document.createRange();
    range.selectNodeContents(walker.currentNode);
    for (const box of range.getClientRects()) {
      if (box.width > 1) found.push([walker.currentNode.data.trim(), corners(box)]);
    }
  }
  return found;
}

// What reaches over the right edge, but for drawings that scroll by themselves.
function outside(document, width) {
  const boxes = [...document.body.querySelectorAll("*")]
    .filter((e) => !e.closest(".scroll") || e.matches(".scroll"))
    .map((e) => [e.tagName, e.getBoundingClientRect().right]);
  const texts = lines(document).map(([text, shape]) => [text, shape[1][0]]);
  return [...boxes, ...texts].filter(([, right]) => right > width + 0.5).map(([name]) => name);
}

function page(frame) {
  const document = frame.contentDocument;
  const width = frame.clientWidth;
  return {
    width,
    scrolls: document.documentElement.scrollWidth > width,
    outside: outside(document, width),
    overlapping: overlapping(lines(document)),
    headed: [...document.querySelectorAll("thead")].every(
      (head) => frame.contentWindow.getComputedStyle(head).display !== "none",
    ),
    background: frame.contentWindow.getComputedStyle(document.body).backgroundColor,
    figures: [...document.querySelectorAll("figure")].map((figure) => ({
      alt: figure.querySelector("img").alt,
      caption: figure.querySelector("figcaption").textContent,
      drawn: figure.querySelector("img").naturalWidth > 0,
    })),
  };
}

// Letters of a drawing are paths; every text is a group that a comment names.
function drawing(holder) {
  const whole = holder.querySelector("svg").getBoundingClientRect();
  const texts = [...holder.querySelectorAll("g[id^=text_]")].map((text) => {
    const inner = text.querySelector("g") || text;
    const name = [...text.childNodes].find((n) => n.nodeType === Node.COMMENT_NODE);
    return [name ? name.data.trim() : "", corners(inner.getBBox(), inner.getScreenCTM())];
  });
  const inside = ([x, y]) =>
    x > whole.left - 1 && x < whole.right + 1 && y > whole.top - 1 && y < whole.bottom + 1;
  return {
    name: holder.id,
    n_texts: texts.length,
    overlapping: overlapping(texts),
    cut: texts.filter(([, shape]) => !shape.every(inside)).map(([name]) => name),
  };
}

window.addEventListener("load", () => {
  const found = {
    pages: [...document.querySelectorAll("iframe")].map(page),
    drawings: [...document.querySelectorAll(".drawing")].map(drawing),
  };
  document.body.innerHTML = "<pre id=found></pre>";
  document.getElementById("found").textContent = JSON.stringify(found);
});
