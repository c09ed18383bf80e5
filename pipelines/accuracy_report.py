#!/usr/bin/env python3
"""Charts and a page from the table of pipelines/accuracy: accuracy_report.py FOLDER

Reads FOLDER/accuracy.csv and FOLDER/pictures, draws with gnuplot and writes FOLDER/index.html, which needs no other file.
Exits with 1 when --quality auto is somewhere more than 10 % off the Pareto front, or loses or invents a hit.
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
GRADIENT_MARKS = [7, 5, 9, 13, 11, 6, 4, 8]
PEERS = {"mc-embree": ("mesh, Embree", "#8c510a", 5), "mc-raster": ("mesh, OpenGL", "#01665e", 13), "opencl": ("OpenCL device", "#762a83", 15)}
NEAR = 1.10  # how far --quality auto may be off the front


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
    """Of the rays that were traced for errors, which are not those of the picture that was timed."""
    rays = sum(int(row[c]) for c in ("tangent", "true_positive", "false_positive", "false_negative", "true_negative"))
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
        points.append({"solve": row["intersect"], "precision": row["precision"], "steps": int(row["steps"]), "ns": number(times[0]["ns_per_ray"]), "instructions": number(times[0]["instructions_per_ray"]),
                       "p99": max(number(row["depth_p99"]), LEAST), "max": number(row["depth_max"]), "ppm": errors_ppm(row), "worst": worst})
    return points


def pareto(points, cost):
    """The points that no other beats in cost and error, among those without errors."""
    sound = [p for p in points if p["worst"] <= HOLLOW_PPM]

    def beats(q, p):
        return q[cost] <= p[cost] and q["p99"] <= p["p99"] and (q[cost] < p[cost] or q["p99"] < p["p99"])
    return [p for p in sound if not any(beats(q, p) for q in sound)]


def cost_column(table):
    """What choices are judged by: instructions, which repeat, where they were counted; otherwise the clock."""
    counted = all(r["instructions_per_ray"] for r in table.select(kind="auto") + table.select(kind="front"))
    return "instructions_per_ray" if counted else "ns_per_ray"


def choices(table):
    """For each view: the row of --quality auto, its wrong rays, and its cost against the cheapest that is sound there and no less
    exact (the front), and against the cheapest within its bound, which only somebody who knows the truth could choose."""
    cost, found = cost_column(table), []
    for row in table.select(kind="auto"):
        front = table.select(kind="front", field=row["field"], size=row["size"], family=row["family"])
        if not front:
            continue
        sound = [r for r in front if errors_ppm(r) == 0]

        def least(error):
            return min([number(r[cost]) for r in sound if number(r["depth_p99"]) <= error], default=number(row[cost]))
        clock = number(row["contender_ratio"]) if row["contender_ratio"] else 1.0
        ratio = number(row[cost]) / least(number(row["depth_p99"])) if cost == "instructions_per_ray" else clock
        found.append({"row": row, "wrong": errors_ppm(row), "ratio": ratio, "clock_ratio": clock,
                      "bound_ratio": number(row[cost]) / least(number(row["bound"]))})
    return found


def judge_choices(table):
    """Prints how near --quality auto is to the front everywhere; returns whether it is near enough."""
    found = choices(table)
    if not found:
        return True
    worst = max(found, key=lambda c: c["ratio"])
    wrong = [c for c in found if c["wrong"]]
    at = "{field} {size} at {family}".format(**worst["row"])
    print(f"--quality auto: {sum(c['ratio'] <= NEAR for c in found)} of {len(found)} views within {100 * (NEAR - 1):.0f} % of the front in {cost_column(table)}, "
          f"the farthest {worst['ratio']:.3f} ({at}); {len(wrong)} with a wrong ray")
    slowest = max(found, key=lambda c: c["clock_ratio"])
    print(f"by the clock (CPU time, medians of frames in pairs): {sum(c['clock_ratio'] <= NEAR for c in found)} of {len(found)}, "
          f"the farthest {slowest['clock_ratio']:.3f} of {slowest['row']['contender']} ({'{field} {size} at {family}'.format(**slowest['row'])})")
    return worst["ratio"] <= NEAR and not wrong


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


def auto_point(table, field, size, column):
    rows = table.select(kind="auto", field=field, size=size, family="distance 1.6")
    return [(r[column], max(number(r["depth_p99"]), LEAST)) for r in rows if r[column]]


def peers_of(table, field, size):
    """The marching-cubes mesh and devices: the tracer, its time to the default's in the same turns, p99 depth error, wrong rays in ppm, and the row."""
    rows = table.select(kind="peer", field=field, size=size)
    own = [number(r["ns_per_ray"]) for r in rows if r["tracer"] not in PEERS]
    return [{"tracer": r["tracer"], "ratio": number(r["ns_per_ray"]) / own[0], "p99": max(number(r["depth_p99"]), LEAST), "worst": errors_ppm(r), "row": r}
            for r in rows if r["tracer"] in PEERS and own]


def plot_peers(peers, cost, prefix):
    """Their points, with the bytes of what they trace beside them. By the clock only: no instructions of theirs are counted."""
    data, plots = "", []
    for p in peers if cost == "ns" else []:
        _, colour, mark = PEERS[p["tracer"]]
        name = f"{prefix}_{p['tracer'].replace('-', '_')}"
        data += data_block(name, [(p["ns"], p["p99"], min(3, 1.2 + 0.4 * math.log10(1 + p["worst"])), f'"{int(p["row"]["bytes"]) / 1e6:.1f} MB"')])
        plots.append(f"${name} using 1:2:3 with points pt {mark - (p['worst'] > HOLLOW_PPM)} ps variable lc rgb '{colour}'")
        plots.append(f"${name} using 1:2:4 with labels offset 0,{-0.9 if p['tracer'] == 'mc-raster' else 0.9} font ',7' tc rgb '{colour}'")
    return data, plots


def axis_tics(low, high):
    """Four round numbers between two, evenly on a logarithmic axis."""
    return ", ".join(dict.fromkeys(f"{low * (high / low) ** (i / 3):.3g}" for i in range(4)))


def draw_pareto(table, folder, name, cost, column, label):
    fields = [f for f in table.fields() if methods_of(table, *f)]
    columns = 3
    lines = math.ceil((len(fields) + 1) / columns)
    body = f"set multiplot layout {lines},{columns}\nset logscale xy\nset format y '10^{{%L}}'\nset xlabel '{label}'\nset ylabel 'p99 depth error, voxels'\nset grid\nunset key\n"
    for n, (field, size) in enumerate(fields):
        points = methods_of(table, field, size)
        floor, pixel = floors(table, field, size)
        peers = peers_of(table, field, size) if cost == "ns" else []
        for p in peers:  # they are timed in larger pictures: where they lie beside the default
            p["ns"] = p["ratio"] * next(q["ns"] for q in points if (q["solve"], q["steps"], q["precision"]) == ("robust", 16, "f64"))
        low, high = min(p[cost] for p in points + peers), max(p[cost] for p in points + peers)
        body += f"set title '{field} {size}' noenhanced\nset xtics ({axis_tics(low, high)})\nset xrange [{low * 0.97}:{high * 1.03}]\nset yrange [{LEAST / 3}:200]\n"
        plots = []
        for solve, precision in [(s, p) for s in SOLVES for p in ("f64", "f32")]:
            curve = sorted((p for p in points if p["solve"] == solve and p["precision"] == precision), key=lambda p: p["steps"])
            if not curve:
                continue
            block = f"d{n}_{solve}_{precision}"
            single = precision == "f32"
            body += data_block(block, [(p[cost], p["p99"]) for p in curve])
            if cost == "instructions":  # by the clock a curve over steps would only connect noise
                plots.append(f"${block} using 1:2 with lines dt {3 if single else 1} lc rgb '{COLOURS[solve]}'")
            for hollow in (False, True):
                marks = [(p[cost], p["p99"], min(3, 0.7 + 0.4 * math.log10(1 + p["worst"]))) for p in curve if (p["worst"] > HOLLOW_PPM) == hollow]
                if marks:
                    body += data_block(f"{block}_{hollow}", marks)
                    plots.append(f"${block}_{hollow} using 1:2:3 with points {point_style(single, hollow)} ps variable lc rgb '{COLOURS[solve]}'")
        data, marks = plot_peers(peers, cost, f"peer{n}")
        body += data
        plots += marks
        front = sorted(pareto(points, cost), key=lambda p: p[cost])
        body += data_block(f"front{n}", [(p[cost], p["p99"]) for p in front] or [("nan", "nan")])
        plots.append(f"$front{n} with steps lw 2 dt 2 lc rgb 'black'")
        chosen = auto_point(table, field, size, column)
        if chosen:
            body += data_block(f"auto{n}", chosen)
            plots.append(f"$auto{n} with points pt 3 ps 2 lw 2 lc rgb 'black'")
        if floor > 0:
            plots.append(f"{floor} lc rgb '#aa0000' dt 3")
        plots.append(f"{pixel} lc rgb '#0000aa' dt 3")
        body += "plot " + ", ".join(plots) + "\n"
    both_formats(folder, name, 420 * columns, 330 * lines, body + legend_panel(cost == "ns") + "unset multiplot\n")


def point_style(single, hollow):
    return f"pt {(8 if hollow else 9) if single else (6 if hollow else 7)}"


def legend_panel(with_peers):
    """The key of all panels, in a panel of its own: it would hide points."""
    plots = [f"1/0 with points pt 7 lc rgb '{COLOURS[s]}' title '{s}'" for s in SOLVES]
    plots += [f"1/0 with points pt {mark} lc rgb '{colour}' title '{words}'" for words, colour, mark in PEERS.values() if with_peers]
    plots += ["1/0 with points pt 7 lc rgb '#666666' title 'f64'", "1/0 with points pt 9 lc rgb '#666666' title 'f32'",
              f"1/0 with points pt 6 lc rgb '#666666' title 'hollow: over {HOLLOW_PPM} ppm wrong rays'",
              "1/0 with points pt 3 ps 2 lw 2 lc rgb 'black' title '--quality auto'", "1/0 with lines lw 2 dt 2 lc rgb 'black' title 'Pareto front'",
              "1/0 with lines lc rgb '#aa0000' dt 3 title 'field error (median)'", "1/0 with lines lc rgb '#0000aa' dt 3 title 'half a pixel at 1024 rows'"]
    return ("unset title\nunset xtics\nunset ytics\nunset border\nunset xlabel\nunset ylabel\nunset grid\nunset logscale\nset xrange [0:1]\nset yrange [0:1]\n"
            "set key at graph 0.9,0.95 top right samplen 2 font ',10'\nplot " + ", ".join(plots) + "\n")


def draw_storage(table, folder):
    body = "set logscale xy\nset grid\nset xlabel 'bytes'\nset ylabel 'p99 depth error against the exact surface, voxels'\nset format x '10^{%L}'\nset format y '10^{%L}'\nset yrange [3e-7:50]\nset key outside right font ',9'\n"
    plots = []
    styles = {"dense": 7, "bricks": 5, "adf": 9}
    shades = {"f32": "#0072b2", "u16": "#009e73", "u8": "#d55e00"}
    for structure, mark in styles.items():
        for samples, colour in shades.items():
            rows = table.select(kind="storage", structure=structure, samples=samples, tracer="")
            if not rows:
                continue
            name = f"{structure}_{samples}"
            body += data_block(name, [(r["bytes"], max(number(r["depth_p99"]), 1e-6), f'"{r["field"]}"') for r in rows])
            plots.append(f"${name} using 1:2 with points pt {mark} ps 1.3 lc rgb '{colour}' title '{structure} {samples}'")
            if name == "dense_f32":
                plots.append(f"${name} using 1:2:3 with labels offset 0,0.8 font ',8' notitle noenhanced")
    cubic = table.select(kind="storage", tracer="tricubic")
    if cubic:
        body += data_block("cubic", [(r["bytes"], max(number(r["depth_p99"]), 1e-6)) for r in cubic])
        plots.append("$cubic using 1:2 with points pt 3 ps 1.3 lc rgb 'black' title 'dense f32, tricubic (Catmull-Rom)'")
    if plots:
        both_formats(folder, "storage", 900, 560, body + "plot " + ", ".join(plots) + "\n")


def draw_gradients(table, folder):
    body = "set logscale y\nset grid\nset ylabel 'p99 angle to the exact normal, degrees'\nset style data points\nset pointsize 1.6\nset xtics rotate by -30\nset key outside right noenhanced\n"
    plots = []
    names = ["analytic", "central", "forward", "backward", "corner-central", "corner-forward", "c0", "crease"]
    tics = ", ".join(f"'{name}' {i}" for i, name in enumerate(names))
    for n, (field, size) in enumerate(table.fields()):
        rows = {r["gradient"]: r for r in table.select(kind="gradient", field=field, size=size)}
        if len(rows) < len(names):
            continue
        body += data_block(f"g{n}", [(i, max(number(rows[name]["normal_p99"]), 1e-3)) for i, name in enumerate(names)])
        plots.append(f"$g{n} title '{field} {size}' pt {GRADIENT_MARKS[n % len(GRADIENT_MARKS)]}")
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
    """What --quality auto takes at each distance, and how far that is from the front."""
    rows = []
    for c in choices(table):
        r = c["row"]
        rows.append([f'{r["field"]} {r["size"]}', r["family"], f'{r["intersect"]} {r["steps"]} {r["precision"]}', r["gradient"], r["bound"], r["depth_p99"], f'{c["wrong"]:.3g}',
                     r["instructions_per_ray"], r["ns_per_ray"], f'{c["ratio"]:.3f}', f'{c["bound_ratio"]:.3f}', r["contender"], f'{c["clock_ratio"]:.3f}'])
    return html_table(["field", "eye", "intersect", "gradient", "bound, voxels", "p99 error", "wrong rays, ppm", "instructions/ray", "ns/ray", "cost / the front's",
                       "cost / the cheapest's within the bound", "contender by the clock", "time / the contender's"], rows)


def peer_table(table):
    """The default beside the marching-cubes mesh and a device, timed in the same turns."""
    rows = []
    for field, size in table.fields():
        for p in peers_of(table, field, size):
            r = p["row"]
            rows.append([f"{field} {size}", p["tracer"], r["isa"], r["ns_per_ray"], f'{p["ratio"]:.2f}', r["depth_p50"], r["depth_p99"],
                         r["depth_max"], short(p["worst"]), r["bytes"]])
    if not rows:
        return "<p>Nothing else was measured.</p>"
    return html_table(["field", "tracer", "on", "ns/ray", "time / the default's", "median error, voxels", "p99", "worst", "wrong rays, ppm", "bytes"], rows)


def mesh_table(table):
    rows = [[r["field"], r["family"], f'{r["intersect"]} {r["steps"]} {r["precision"]}', r["depth_p50"], r["depth_p99"], r["false_positive"], r["false_negative"], r["leaks"], r["rays"]]
            for r in table.select(kind="solve", truth="mesh")]
    return html_table(["field", "rays", "solve", "median, voxels", "p99", "false hits", "false misses", "leaks", "of"], rows) if rows else "<p>No mesh was measured.</p>"


def all_rows(table):
    chosen = ["kind", "field", "size", "structure", "samples", "tracer", "intersect", "steps", "precision", "gradient", "truth", "family", "rays", "tangent", "true_positive",
              "false_positive", "false_negative", "true_negative", "leaks", "wrong_face", "depth_p50", "depth_p99", "depth_max", "normal_p99", "ns_per_ray", "instructions_per_ray", "bytes"]
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


def counted_text(table):
    ways = {(r["counted"], r["isa"]) for r in table.rows if r["counted"]}
    return ", ".join(sorted(f"{way}, {isa}" for way, isa in ways)) or "no counter of the processor could be read, and valgrind is missing, so there are none"


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
<h2>What --quality auto takes</h2><p>Against the measured front at three distances (rays from the eye to the field): the cheapest method with the same gradient that has no wrong ray there and is no less exact. Cost is {cost_column(table)}. The cheapest within the bound is known only after the truth is: it is another method in each view. The last columns are the clock: of the three fastest methods that are sound there and no less exact, the one that does best when its frames and those of the choice are drawn in pairs, and the median of their ratios in CPU time.</p>{auto_table(table)}
<h2>Against the mesh</h2><p>The whole pipeline: the mesh itself is the truth. What is left is the field's error; no solver that isolates changes it.</p>{mesh_table(table)}
<h2>Error against time</h2><p>Markers grow with the worst errors over all families of rays; hollow: a method with more than {HOLLOW_PPM} ppm.</p>{inline_svg(folder, "pareto")}
<h3>Beside others</h3><p>The marching-cubes mesh of the same field (its bytes include Embree's tree) and an OpenCL device, one thread each; errors against the trilinear field, over the camera's rays (mc-raster, which draws pictures only: over the pixels of the chart's view). Times are of larger pictures than above, in turns with the default: the chart shows their ratio to it.</p>{peer_table(table)}
<h2>Error against instructions</h2><p>The same, counted: {counted_text(table)}.</p>{inline_svg(folder, "pareto-instructions")}
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
    draw_pareto(table, folder, "pareto", "ns", "ns_per_ray", "ns/ray")
    if cost_column(table) == "instructions_per_ray":
        draw_pareto(table, folder, "pareto-instructions", "instructions", "instructions_per_ray", "instructions/ray")
    draw_storage(table, folder)
    draw_gradients(table, folder)
    write_page(table, folder)
    if not judge_choices(table):
        sys.exit(1)


main()
