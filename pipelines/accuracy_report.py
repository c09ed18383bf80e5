#!/usr/bin/env python3
"""Charts and a page from the table of pipelines/accuracy: accuracy_report.py FOLDER

Reads FOLDER/accuracy.csv and FOLDER/pictures, draws with gnuplot and writes FOLDER/index.html, which needs no other file.
"""
import base64
import csv
import html
import math
import os
import subprocess
import sys

SOLVES = ["midpoint", "linear", "repeated", "marmitt", "analytic", "robust"]
COLOURS = {"midpoint": "#999999", "linear": "#e69f00", "repeated": "#d55e00", "marmitt": "#0072b2", "analytic": "#cc79a7",
           "robust": "#009e73", "auto": "#000000"}
LEAST = 1e-16  # errors below are drawn here
HOLLOW_PPM = 10


def number(text):
    return float(text) if text else math.nan


class Table:
    def __init__(self, path):
        with open(path, newline="") as file:
            self.rows = list(csv.DictReader(file))
        if not self.rows:
            sys.exit(f"accuracy_report: {path}: no rows")

    def select(self, **wanted):
        return [r for r in self.rows if all(r[k] == v for k, v in wanted.items())]

    def fields(self):
        seen = []
        for r in self.rows:
            key = (r["field"], r["size"])
            if r["kind"] == "solve-time" and key not in seen:
                seen.append(key)
        return seen


def errors_ppm(row):
    rays = int(row["rays"])
    return 1e6 * sum(int(row[c]) for c in ("false_positive", "false_negative", "leaks", "wrong_face")) / rays


def methods_of(table, field, size):
    """For each method: solve, steps, ns/ray, p99 depth error in voxels over the camera's rays, errors in ppm over all families."""
    points = []
    for row in table.select(kind="solve", field=field, size=size, family="camera", truth="field"):
        key = {"field": field, "size": size, "intersect": row["intersect"], "steps": row["steps"], "precision": row["precision"]}
        times = table.select(kind="solve-time", **key)
        if not times:
            continue
        families = table.select(kind="solve", truth="field", **key)
        worst = max(errors_ppm(r) for r in families)
        points.append({"solve": row["intersect"], "precision": row["precision"], "steps": int(row["steps"]), "ns": number(times[0]["ns_per_ray"]),
                       "p99": max(number(row["depth_p99"]), LEAST), "max": number(row["depth_max"]), "ppm": errors_ppm(row), "worst": worst})
    return points


def pareto(points):
    """The points that no other beats in time and error, among those without errors."""
    sound = [p for p in points if p["worst"] <= HOLLOW_PPM]
    return [p for p in sound if not any(q["ns"] <= p["ns"] and q["p99"] <= p["p99"] and q is not p for q in sound)]


def floors(table, field, size):
    rows = table.select(kind="solve", field=field, size=size, family="camera", truth="field")
    floor = number(rows[0]["field_floor"]) if rows else 0
    pixel = 0.5 * 1.6 * int(size) * 2 * math.tan(0.5) / 1024  # half a pixel at the middle of a picture of 1024 rows
    return floor, pixel


def gnuplot(script):
    done = subprocess.run(["gnuplot"], input=script, text=True, capture_output=True)
    if done.returncode != 0:
        sys.exit("accuracy_report: gnuplot: " + done.stderr.strip())


def both_formats(folder, name, width, height, body):
    gnuplot(f"set terminal svg size {width},{height} dynamic font 'sans,12' background '#ffffff'\nset output '{folder}/{name}.svg'\n{body}")
    gnuplot(f"set terminal pngcairo size {width},{height} font 'sans,10' background '#ffffff'\nset output '{folder}/{name}.png'\n{body}")


def data_block(name, points):
    return f"${name} << EOD\n" + "".join(" ".join(str(v) for v in p) + "\n" for p in points) + "EOD\n"


def draw_pareto(table, folder):
    fields = table.fields()
    columns = 3
    lines = math.ceil(len(fields) / columns)
    body = f"set multiplot layout {lines},{columns}\nset logscale xy\nset format y '%.0e'\nset xlabel 'ns/ray'\nset ylabel 'p99 depth error, voxels'\nset grid\n"
    for n, (field, size) in enumerate(fields):
        points = methods_of(table, field, size)
        if not points:
            continue
        floor, pixel = floors(table, field, size)
        low, high = min(p["ns"] for p in points), max(p["ns"] for p in points)
        tics = ", ".join(f"{low * (high / low) ** (i / 3):.3g}" for i in range(4))
        body += f"set title '{field} {size}' noenhanced\nset xtics ({tics})\nset xrange [{low * 0.95}:{high * 1.05}]\nset yrange [{LEAST / 3}:200]\n"
        body += "set key bottom left samplen 1 font ',8'\n" if n == 0 else "unset key\n"
        plots = []
        for solve, precision in [(s, p) for s in SOLVES for p in ("f64", "f32")]:
            curve = sorted((p for p in points if p["solve"] == solve and p["precision"] == precision), key=lambda p: p["steps"])
            if not curve:
                continue
            name = f"d{n}_{solve}_{precision}"
            single = precision == "f32"
            body += data_block(name, [(p["ns"], p["p99"], min(3, 0.7 + 0.4 * math.log10(1 + p["worst"]))) for p in curve])
            hollow = max(p["worst"] for p in curve) > HOLLOW_PPM
            plots.append(f"${name} using 1:2 with lines dt {3 if single else 1} lc rgb '{COLOURS[solve]}' notitle")
            plots.append(f"${name} using 1:2:3 with points pt {(8 if hollow else 9) if single else (6 if hollow else 7)} ps variable lc rgb '{COLOURS[solve]}' title '{solve} {precision}'")
        front = sorted(pareto(points), key=lambda p: p["ns"])
        body += data_block(f"front{n}", [(p["ns"], p["p99"]) for p in front] or [("nan", "nan")])
        plots.append(f"$front{n} with steps lw 2 dt 2 lc rgb 'black' title 'Pareto front'")
        if floor > 0:
            plots.append(f"{floor} lc rgb '#aa0000' dt 3 title 'field error (median)'")
        plots.append(f"{pixel} lc rgb '#0000aa' dt 3 title 'half a pixel at 1024 rows'")
        body += "plot " + ", ".join(plots) + "\n"
    both_formats(folder, "pareto", 420 * columns, 330 * lines, body + "unset multiplot\n")


def draw_storage(table, folder):
    body = "set logscale xy\nset grid\nset xlabel 'bytes'\nset ylabel 'p99 depth error against the exact surface, voxels'\nset format x '%.0e'\nset key outside right font ',9'\n"
    plots = []
    styles = {"dense": 7, "bricks": 5, "adf": 9}
    shades = {"f32": "#0072b2", "u16": "#009e73", "u8": "#d55e00"}
    for structure, mark in styles.items():
        for samples, colour in shades.items():
            rows = table.select(kind="storage", structure=structure, samples=samples)
            if not rows:
                continue
            name = f"{structure}_{samples}"
            body += data_block(name, [(r["bytes"], max(number(r["depth_p99"]), 1e-6), f'"{r["field"]}"') for r in rows])
            plots.append(f"${name} using 1:2 with points pt {mark} ps 1.3 lc rgb '{colour}' title '{structure} {samples}'")
            if name == "dense_f32":
                plots.append(f"${name} using 1:2:3 with labels offset 0,0.8 font ',8' notitle noenhanced")
    if plots:
        both_formats(folder, "storage", 900, 560, body + "plot " + ", ".join(plots) + "\n")


def draw_gradients(table, folder):
    body = "set logscale y\nset grid\nset ylabel 'p99 angle to the exact normal, degrees'\nset style data linespoints\nset xtics rotate by -30\nset key outside right noenhanced\n"
    plots = []
    names = ["analytic", "central", "forward", "backward", "corner-central", "corner-forward", "c0", "crease"]
    tics = ", ".join(f"'{name}' {i}" for i, name in enumerate(names))
    for n, (field, size) in enumerate(table.fields()):
        rows = {r["gradient"]: r for r in table.select(kind="gradient", field=field, size=size)}
        if len(rows) < len(names):
            continue
        body += data_block(f"g{n}", [(i, max(number(rows[name]["normal_p99"]), 1e-3)) for i, name in enumerate(names)])
        plots.append(f"$g{n} title '{field} {size}'")
    if plots:
        both_formats(folder, "gradients", 900, 480, body + f"set xtics ({tics})\nset xrange [-0.3:7.3]\nplot " + ", ".join(plots) + "\n")


def inline_svg(folder, name):
    path = os.path.join(folder, name + ".svg")
    if not os.path.exists(path):
        return ""
    with open(path) as file:
        text = file.read()
    return text[text.index("<svg"):]


def inline_png(path):
    with open(path, "rb") as file:
        return "data:image/png;base64," + base64.b64encode(file.read()).decode()


def html_table(header, rows):
    out = "<table><tr>" + "".join(f"<th>{html.escape(h)}</th>" for h in header) + "</tr>\n"
    for row in rows:
        out += "<tr>" + "".join(f"<td>{html.escape(str(v))}</td>" for v in row) + "</tr>\n"
    return out + "</table>\n"


def short(value):
    return "" if math.isnan(value) else f"{value:.3g}"


def summary_table(table):
    """Per method: what it costs against the default, and the worst of all fields."""
    rows = []
    default = {}
    everything = {}
    for field, size in table.fields():
        for p in methods_of(table, field, size):
            key = (p["solve"], p["steps"], p["precision"])
            everything.setdefault(key, []).append((field, size, p))
            if key == ("robust", 16, "f64"):
                default[field, size] = p["ns"]
    for (solve, steps, precision), found in everything.items():
        ratios = sorted(p["ns"] / default[f, s] for f, s, p in found if (f, s) in default)
        worst = max(found, key=lambda x: x[2]["p99"])
        wrong = max(found, key=lambda x: x[2]["worst"])
        rows.append([solve, steps or "", precision, short(ratios[len(ratios) // 2]) if ratios else "", short(worst[2]["p99"]), worst[0],
                     short(wrong[2]["worst"]), wrong[0] if wrong[2]["worst"] else ""])
    return html_table(["solve", "steps", "precision", "time / default (median of fields)", "worst p99 error, voxels", "in", "worst errors, ppm of rays", "in"], rows)


def recommendation_table(table):
    rows = []
    for field, size in table.fields():
        points = methods_of(table, field, size)
        floor, pixel = floors(table, field, size)
        bound = max(floor, pixel) / 10
        fit = [p for p in points if p["worst"] == 0 and p["p99"] <= bound]
        best = min(fit, key=lambda p: p["ns"]) if fit else None
        rows.append([f"{field} {size}", short(floor) if floor else "not known", short(pixel), short(bound),
                     f"{best['solve']} {best['steps'] or ''} {best['precision']}" if best else "none", short(best["ns"]) if best else ""])
    return html_table(["field", "field error, voxels", "half a pixel, voxels", "a tenth of the higher", "cheapest without errors", "ns/ray"], rows)


def auto_table(table):
    """What --quality auto takes at each distance against the cheapest with no fewer steps and the same gradient or a finer one."""
    rows = []
    for row in table.select(kind="auto-time"):
        same = {"field": row["field"], "size": row["size"], "family": row["family"], "kind": "front-time"}
        front = [r for r in table.select(**same) if int(r["steps"]) >= int(row["steps"]) and r["gradient"] in (row["gradient"], "corner-central")]
        default = table.select(**same, steps="16", precision="f64", gradient="corner-central")
        if not front or not default:
            continue
        least, ns = min(number(r["ns_per_ray"]) for r in front), number(row["ns_per_ray"])
        rows.append([row["field"], row["family"], f'{row["intersect"]} {row["steps"]}', row["gradient"], short(ns), f"{ns / least:.2f}",
                     f"{ns / number(default[0]['ns_per_ray']):.2f}"])
    return html_table(["field", "eye", "intersect", "gradient", "ns/ray", "time / the front's", "time / default's"], rows)


def mesh_table(table):
    rows = [[r["field"], r["family"], f'{r["intersect"]} {r["steps"]} {r["precision"]}', r["depth_p50"], r["depth_p99"], r["false_positive"], r["false_negative"], r["leaks"], r["rays"]]
            for r in table.select(kind="solve", truth="mesh")]
    return html_table(["field", "rays", "solve", "median, voxels", "p99", "false hits", "false misses", "leaks", "of"], rows) if rows else "<p>No mesh was measured.</p>"


def all_rows(table):
    chosen = ["kind", "field", "size", "structure", "samples", "tracer", "intersect", "steps", "precision", "gradient", "truth", "family", "rays", "tangent", "true_positive",
              "false_positive", "false_negative", "true_negative", "leaks", "wrong_face", "depth_p50", "depth_p99", "depth_max", "normal_p99", "ns_per_ray", "bytes"]
    return html_table(chosen, [[r[c] for c in chosen] for r in table.rows])


def pictures(folder):
    out = ""
    for shape, words in (("pairs", "random samples"), ("shell", "a shell of 0.9 voxel"), ("gyroid", "a slab of the gyroid"), ("rotated-box", "a box at odd angles")):
        out += f"<h3>{words}</h3><div class=row>"
        for solve in SOLVES:
            path = os.path.join(folder, "pictures", f"{shape}-{solve}")
            if os.path.exists(path + ".png"):
                out += f"<figure><img src='{inline_png(path + '.png')}'><br><img src='{inline_png(path + '-error.png')}'><figcaption>{solve}</figcaption></figure>"
        out += "</div>\n"
    return out


def write_page(table, folder):
    first = table.rows[0]
    page = f"""<!doctype html><meta charset=utf-8><title>distfield: accuracy against time</title>
<style>body{{font:15px sans-serif;max-width:1300px;margin:2em auto;padding:0 1em}}table{{border-collapse:collapse;font-size:13px}}
td,th{{border:1px solid #ccc;padding:2px 6px;text-align:left}}.row{{display:flex;flex-wrap:wrap}}figure{{margin:4px;width:200px;text-align:center}}
figure img{{width:200px}}svg{{max-width:100%;height:auto}}details{{margin:1em 0}}</style>
<h1>Accuracy against time</h1>
<p>Take <b>robust</b> (the default): it is the only solve that makes no error in any field and whose error lies far below both floors, and it costs what the others cost,
as a ray is solved once, in the voxel that holds its hit. The others are there to compare with: <b>midpoint</b>, <b>linear</b> and <b>repeated</b> look at the two ends of
a voxel only and miss pairs of crossings; <b>marmitt</b> finds all of them but places some up to a tenth of a voxel off; <b>analytic</b> is exact
until a cubic term of rounding size spoils it.</p>
<p>Machine: {html.escape(first["machine"])}. Compiler: {html.escape(first["compiler"])}. Version {html.escape(first["version"])}. Seed {first["seed"]}.
Errors are those of the solver against the trilinear field in quad precision; times are medians of whole frames, one thread, rays to shaded picture.</p>
<h2>Which method</h2>{summary_table(table)}
<h2>The cheapest that a scene needs</h2><p>The cheapest method without errors whose p99 error lies under a tenth of the higher of two floors.</p>{recommendation_table(table)}
<h2>What --quality auto takes</h2><p>Beside the cheapest whose steps and gradient are no coarser; ratios scatter by the noise of the machine.</p>{auto_table(table)}
<h2>Against the mesh</h2><p>The whole pipeline: the mesh itself is the truth. What is left is the field's error; no solver that isolates changes it.</p>{mesh_table(table)}
<h2>Error against time</h2><p>Markers grow with the worst errors over all families of rays; hollow: a method with more than {HOLLOW_PPM} ppm.</p>{inline_svg(folder, "pareto")}
<h2>Error against bytes</h2>{inline_svg(folder, "storage")}
<h2>Normals</h2>{inline_svg(folder, "gradients")}
<h2>What failing looks like</h2><p>Above the picture, below its depth error: blue 1e-6 voxel and less, green 1e-3, red 1 and more; magenta a hole, white a hit of nothing.</p>{pictures(folder)}
<details><summary>All rows</summary>{all_rows(table)}</details>
"""
    with open(os.path.join(folder, "index.html"), "w") as file:
        file.write(page)


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: accuracy_report.py FOLDER")
    folder = sys.argv[1]
    table = Table(os.path.join(folder, "accuracy.csv"))
    draw_pareto(table, folder)
    draw_storage(table, folder)
    draw_gradients(table, folder)
    write_page(table, folder)


main()
