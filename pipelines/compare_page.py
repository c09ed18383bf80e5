"""Charts, words and the page of pipelines/compare: write(folder, rows, shows)."""
import base64
import html
import math
import os
import subprocess

NAMES = {"auto": "ray tracing", "dda": "scalar 3DDDA", "adf": "octree (ADF)", "mc-raster": "mesh, OpenGL", "mc-embree": "mesh, Embree"}
COLOURS = {"auto": "#0072b2", "dda": "#999999", "adf": "#cc79a7", "mc-raster": "#d55e00", "mc-embree": "#009e73"}


def three_digits(x):
    """Three digits that count, or all of a larger number: never a power of ten."""
    return f"{x:.3g}" if x < 1000 else f"{x:.0f}"


def chart(folder, name, title, x_label, y_label, curves):
    """curves: by tracer, points (x, y). Logarithmic axes, marked where the points are; the SVG is small, so that its text is readable on a phone."""
    curves = {tracer: sorted(points) for tracer, points in curves.items() if points}
    at = sorted({x for points in curves.values() for x, _ in points})
    marks = ", ".join(f'"{three_digits(x)}" {x}' for x in at)
    lines = [f"set xtics ({marks})", f"set xrange [{at[0] / 1.2}:{at[-1] * 1.2}]", f'set title "{title}"', f'set xlabel "{x_label}" offset 0,0.4', f'set ylabel "{y_label}"', "set logscale xy", "set grid", "set key outside bottom center horizontal maxcols 2", "set bmargin 6.5",
             "set style data linespoints"]
    # a line ends where the next point stands above it: fields of one size
    rows = lambda points: "".join("\n" * (i > 0 and x == points[i - 1][0]) + f"{x} {y}\n" for i, (x, y) in enumerate(points))
    blocks = "".join(f"$d{i} << EOD\n" + rows(points) + "EOD\n" for i, points in enumerate(curves.values()))
    plots = ", ".join(f'$d{i} using 1:2 title "{NAMES.get(t, t)}" lw 2 pt 7 ps 0.8 lc rgb "{COLOURS.get(t, "#000000")}"' for i, t in enumerate(curves))
    for terminal, extension in ('svg size 420,360 font "sans-serif,13" background "#ffffff"', "svg"), ("pngcairo size 1260,1080 font 'sans,28'", "png"):
        path = os.path.join(folder, f"{name}.{extension}")
        script = blocks + "\n".join([f"set terminal {terminal}", f'set output "{path}"', *lines, "plot " + plots]) + "\n"
        done = subprocess.run(["gnuplot"], input=script, text=True, capture_output=True)
        if done.returncode:
            raise RuntimeError("gnuplot: " + done.stderr.strip().split("\n")[-1])
    return os.path.join(folder, name + ".svg")


def charts(folder, rows):
    main_size = sorted({r["megapixels"] for r in rows})[len({r["megapixels"] for r in rows}) // 2]
    largest = max(r["voxels"] for r in rows)
    by = lambda x, y, keep, unit=1: {t: [(r[x], r[y] / unit) for r in rows if r["tracer"] == t and keep(r) and r[y]] for t in NAMES}
    at_size, at_field = (lambda r: r["megapixels"] == main_size), (lambda r: r["voxels"] == largest)
    return [chart(folder, "frame-by-voxels", f"A picture of {main_size:.2g} megapixels", "voxels along the longest side", "ms", by("voxels", "frame_ms", at_size)),
            chart(folder, "frame-by-pixels", f"A picture of the field of {largest} voxels", "megapixels", "ms", by("megapixels", "frame_ms", at_field)),
            chart(folder, "first-by-voxels", "The first picture, with all that it needs", "voxels along the longest side", "ms", by("voxels", "first_ms", at_size)),
            chart(folder, "bytes-by-voxels", "What is kept in memory to draw", "voxels along the longest side", "MB", by("voxels", "bytes", at_size, 1e6))]


def slope(points):
    """The exponent of growth between the first and the last point."""
    (x0, y0), (x1, y1) = min(points), max(points)
    return math.log(y1 / y0) / math.log(x1 / x0) if x1 > x0 else math.nan


def growth_words(rows):
    """How times grow with the field's side and with the pixels: the seed's claim, measured."""
    sizes, words = sorted({r["megapixels"] for r in rows}), []
    size, largest = sizes[len(sizes) // 2], max(r["voxels"] for r in rows)
    for tracer in NAMES:
        side = [(r["voxels"], r["frame_ms"]) for r in rows if r["tracer"] == tracer and r["megapixels"] == size]
        pixels = [(r["megapixels"], r["frame_ms"]) for r in rows if r["tracer"] == tracer and r["voxels"] == largest]
        if len(side) > 1 and len(pixels) > 1:
            words.append(f"{NAMES[tracer]}: twice the voxels along a side take {2 ** slope(side):.2f} times as long, twice the pixels {2 ** slope(pixels):.2f} times "
                         f"(powers {slope(side):.2f} and {slope(pixels):.2f}).")
    return words


def crossing_words(ray, mesh):
    """From how many pictures of an unchanged field on the mesh costs less, and what a changed field costs."""
    later, faster = mesh["first_ms"] - ray["first_ms"], ray["frame_ms"] - mesh["frame_ms"]  # n pictures: the mesh saves (n - 1) * faster - later
    edit = f"; after an edit, {figure(mesh['edit_ms'])} ms to the next picture, and {figure(ray['edit_ms'])} by ray tracing"
    name = NAMES[mesh["tracer"]]
    if later < 0 and faster >= 0:
        return f"{name}: cheaper from the first picture on{edit}"
    if faster > 0:
        return f"{name}: from {math.floor(later / faster) + 2} pictures of an unchanged field on the mesh is cheaper{edit}"
    if later < 0:
        return f"{name}: cheaper up to {math.ceil(later / faster)} pictures of an unchanged field{edit}"
    first = mesh["first_ms"] / ray["first_ms"]
    return f"{name}: never cheaper; a picture takes {mesh['frame_ms'] / ray['frame_ms']:.2g} times as long, the first {first:.2g} times{edit}"


def data_uri(kind, data):
    return f"data:{kind};base64," + base64.b64encode(data).decode()


def figure(value, digits=3):
    return "" if value in (None, "") else f"{value:.{digits}g}" if isinstance(value, float) else f"{value:,}"


def amount(value):
    """A large count in a few letters."""
    return "" if value in (None, "", 0) else f"{value / 1e6:.3g} M" if value >= 1e6 else f"{value / 1e3:.3g} k"


LINES = [("extract_ms", "extracting the mesh, ms", figure), ("build_ms", "masks, tree or upload, ms", figure), ("first_frame_ms", "a picture with what only the first needs, ms", figure),
         ("first_ms", "these three: the first picture, ms", figure), ("frame_ms", "a further picture, ms", figure), ("edit_ms", "measured after an edit, ms", figure), ("bytes", "bytes kept", amount),
         ("triangles", "triangles", amount), ("depth_median", "depth off, median voxel", figure), ("depth_p99", "depth off, 99 %", figure),
         ("mesh_median", "off the original, median voxel", figure), ("mesh_p99", "off the original, 99 %", figure),
         ("normal_mean_deg", "normals off, mean °", figure), ("pixels_off", "pixels off, share", figure)]


def table(rows):
    """A column for each tracer, that fits a phone and paper, and a line for what is known of any of them."""
    head = "".join(f"<th>{html.escape(NAMES.get(r['tracer'], r['tracer']))}</th>" for r in rows)
    body = "".join(f"<tr><td>{title}</td>" + "".join(f"<td>{show(r.get(column))}</td>" for r in rows) + "</tr>" for column, title, show in LINES
                   if any(show(r.get(column)) for r in rows))
    return f"<div class=wide><table><tr><th></th>{head}</tr>{body}</table></div>"


def section(show, rows):
    """One field: wipe between two pictures, their differences from the reference, the table."""
    name = html.escape(show["name"])
    own = [r for r in rows if r["field"] == show["name"]]
    sizes = sorted({r["megapixels"] for r in own})
    if not own:
        return ""
    chosen = [r for r in own if r["megapixels"] == sizes[len(sizes) // 2]]
    ray = next(r for r in chosen if r["tracer"] == "auto") if any(r["tracer"] == "auto" for r in chosen) else chosen[0]
    words = "".join(f"<li>{html.escape(crossing_words(ray, r))}.</li>" for r in chosen if r["tracer"].startswith("mc-"))
    titles = list(show["images"])
    right = next((t for t in titles if t.startswith("mc-")), titles[-1])
    pick = lambda which, value: f"<select class={which} aria-label='{which} picture'>" + "".join(
        f"<option value='{t}'{' selected' if t == value else ''}>{html.escape(NAMES.get(t, t))}</option>" for t in titles) + "</select>"
    store = "".join(f"<img hidden data-of='{t}' alt='' src='{data_uri('image/png', png)}'>" for t, png in show["images"].items())
    same = {r["tracer"] for r in own if not any(r[column] for column in ("depth_max", "hits_only_here", "hits_missed"))}
    differences = "".join(f"<figure><img alt='difference of {html.escape(NAMES.get(t, t))}' src='{data_uri('image/png', png)}'><figcaption>{html.escape(NAMES.get(t, t))}"
                          f"{': no difference' if t in same else ''}"
                          "</figcaption></figure>" for t, png in show["differences"].items() if t != "dda")
    return (f"<section class=field><h2>{name}, {show['voxels']} voxels</h2><p class=picks>{pick('left', titles[0])} {pick('right', right)}</p>"
            f"<div class=wipe><img class=under alt='left picture'><img class=over alt='right picture'><input type=range min=0 max=100 value=50 "
            f"aria-label='wipe between the two pictures'></div>{store}"
            f"<p>Where depths differ from the reference, white at 1e-5 voxel to dark red at 1; blue: only one of the two sees a surface.</p>"
            f"<div class=row>{differences}</div><ul>{words}</ul><p>At {chosen[0]['width']} × {chosen[0]['height']} pixels:</p>{table(chosen)}</section>")


STYLE = """
:root { color-scheme: light; } * { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto; padding: 1rem; max-width: 60rem; }
h1 { font-size: 1.6rem; line-height: 1.2; } h2 { font-size: 1.2rem; margin-top: 2.5rem; }
img { max-width: 100%; height: auto; display: block; } img[hidden] { display: none; }
figure { margin: 0; } figcaption { font-size: .85rem; color: #555; }
.charts, .row { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 20rem), 1fr)); gap: 1rem; }
.wipe { position: relative; max-width: 640px; } .wipe img { width: 100%; } .wipe .over { position: absolute; inset: 0; clip-path: inset(0 0 0 50%); }
.wipe input { width: 100%; height: 2rem; margin: .5rem 0; } .picks { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem; max-width: 640px; }
select { font: inherit; padding: .3rem; min-width: 0; } .picks .right { justify-self: end; } .row img { border: 1px solid #ddd; width: 100%; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #ddd; text-align: right; } th:first-child, td:first-child { text-align: left; } th { font-weight: 600; vertical-align: bottom; }
@media (max-width: 30rem) { body { padding: .75rem; } table { font-size: .75rem; } th, td { padding: .3rem .2rem; } }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; } h2 { break-before: page; margin-top: 0; } h2, .picks { break-after: avoid; }
  .charts, .row { grid-template-columns: 1fr 1fr; } figure, .wipe, table, li { break-inside: avoid; } .wide { overflow: visible; } table { font-size: 8pt; }
  .wipe input { display: none; } .picks, .wipe { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem; max-width: none; }
  select { appearance: none; border: 0; background: none; padding: 0; } .picks .right { justify-self: start; }
  .wipe .over { position: static; clip-path: none !important; }
}
"""
SCRIPT = """
for (const field of document.querySelectorAll('.field')) {
  const get = name => field.querySelector(name), picture = tracer => get(`img[data-of='${tracer}']`).src;
  const update = () => {
    get('.under').src = picture(get('.left').value);
    get('.over').src = picture(get('.right').value);
    get('.over').style.clipPath = `inset(0 0 0 ${get('input').value}%)`;
  };
  for (const control of field.querySelectorAll('select, input')) control.addEventListener('input', update);
  update();
}
document.body.dataset.ready = 'yes';
"""


def write(folder, rows, shows):
    pictures = "".join(f"<figure><img alt='{os.path.basename(p)[:-4]}' src='{data_uri('image/svg+xml', open(p, 'rb').read())}'></figure>" for p in charts(folder, rows))
    growth = "".join(f"<li>{html.escape(w)}</li>" for w in growth_words(rows))
    page = ("<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width, initial-scale=1'>"
            f"<title>Ray tracing a field, or drawing its mesh</title><style>{STYLE}</style><body><h1>Ray tracing a field, or drawing its marching-cubes mesh</h1>"
            "<p>The same fields, camera and shading. <i>Before</i> is all that happens between the field in memory and the first picture: masks for ray tracing; "
            "extraction, tree or upload for the mesh. The first picture is all that and a picture, with what is made at its first use (OpenGL's code for "
            "shaders, say). An edit of the field makes it happen again; that picture is measured as a whole.</p>"
            f"<div class=charts>{pictures}</div><ul>{growth}</ul>{''.join(section(s, rows) for s in shows)}<script>{SCRIPT}</script></body></html>")
    with open(os.path.join(folder, "index.html"), "w", encoding="utf-8") as file:
        file.write(page)
