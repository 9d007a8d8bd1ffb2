"""Sentences of the certificate in its languages; a pair for each key, English and German."""

from collections.abc import Mapping
from functools import cache

LANGUAGES = ("en", "de")

_WORDS = {
    "title": ("Certificate data of a robot calibration", "Zertifikatsdaten einer Roboterkalibrierung"),
    "second": ("Uncertainty, workspace, files", "Unsicherheit, Arbeitsraum, Dateien"),
    "data": ("certificate data", "Zertifikatsdaten"),
    "about": (
        "These are certificate data, computed from readings and statements of the issuer. They state no accreditation.",
        "Dies sind Zertifikatsdaten, berechnet aus Messwerten und Angaben des Ausstellers. Sie bescheinigen keine "
        "Akkreditierung.",
    ),
    "object": ("Object, instrument, conditions", "Gegenstand, Messgerät, Bedingungen"),
    "results": ("Results", "Ergebnisse"),
    "decided": ("Statement of conformity", "Konformitätsaussage"),
    "unstated": ("What is not stated", "Was nicht angegeben ist"),
    "all": ("Everything that these pages ask for is stated.", "Alle erfragten Angaben liegen vor."),
    "budget": (
        "Uncertainty budget (after calibration, JCGM 100:2008)",
        "Unsicherheitsbudget (nach der Kalibrierung, JCGM 100:2008)",
    ),
    "pictures": ("Errors over the workspace", "Abweichungen im Arbeitsraum"),
    "files": ("Files", "Dateien"),
    "file": ("file", "Datei"),
    "number": ("Number", "Nummer"),
    "issued": ("Issued on", "Ausgestellt am"),
    "issuer": ("Issued by", "Aussteller"),
    "customer": ("Customer", "Auftraggeber"),
    "robot": ("Robot", "Roboter"),
    "serial": ("serial number", "Seriennummer"),
    "measured": ("Measured on, by", "Gemessen am, durch"),
    "origin": ("Data", "Daten"),
    "real": ("real measurements", "echte Messungen"),
    "synthetic": ("SYNTHETIC, made by a simulation", "SYNTHETISCH, aus einer Simulation"),
    "unstated_origin": ("of unstated origin", "Herkunft nicht angegeben"),
    "instrument": ("Instrument", "Messgerät"),
    "calibrated": ("Calibration of the instrument", "Kalibrierung des Messgeräts"),
    "traceability": ("Traceability (as stated)", "Rückführung (wie angegeben)"),
    "place": ("Place", "Ort"),
    "temperature": ("Temperature", "Temperatur"),
    "method": ("Method, software", "Verfahren, Software"),
    "KM": ("kinematic model", "kinematisches Modell"),
    "SKCM": ("kinematics and joint compliance", "Kinematik und Gelenknachgiebigkeit"),
    "other": ("identified model", "identifiziertes Modell"),
    "space": ("Poses", "Posen"),
    "space_of": (
        "{n} held-out poses, not used in the fit; base frame [mm]: {span}",
        "{n} zurückgehaltene Posen, nicht in der Anpassung; Basissystem [mm]: {span}",
    ),
    "remark": ("Remark", "Bemerkung"),
    "not_stated": ("not stated", "nicht angegeben"),
    "before": ("before (base and tool fitted)", "vorher (Basis, Werkzeug angepasst)"),
    "after": ("after calibration", "nach der Kalibrierung"),
    "error": ("position error E ± U", "Positionsabweichung E ± U"),
    "rms": ("rms as read [mm]", "RMS wie gelesen [mm]"),
    "worst": ("greatest [mm]", "größte [mm]"),
    "measurand": (
        "E is the rms distance between the tool's position by the model and its true position over the space of these "
        "poses, the base placed; noise of the instrument and repeatability are taken out. U is the expanded "
        "uncertainty, coverage about 95 %.",
        "E ist der quadratische Mittelwert des Abstands zwischen Modell und wahrer Werkzeugposition im Raum dieser "
        "Posen, Basis angepasst; Rauschen des Messgeräts und Wiederholbarkeit sind abgezogen. U ist die erweiterte "
        "Unsicherheit, Überdeckung etwa 95 %.",
    ),
    "refit": (
        "E is that of the robot fitted without the held-out poses; once judged, the robot file was fitted to all {n}.",
        "E gilt für den ohne die zurückgehaltenen Posen angepassten Roboter; danach wurde die Roboterdatei an alle {n} "
        "angepasst.",
    ),
    "no_decision": (
        "No tolerance was stated, so no conformity is stated.",
        "Ohne Toleranz gibt es keine Konformitätsaussage.",
    ),
    "conforms": ("CONFORMS: E + U = {E} + {U} mm is within {T} mm.", "KONFORM: E + U = {E} + {U} mm liegt in {T} mm."),
    "fails": (
        "DOES NOT CONFORM: E - U = {E} - {U} mm is beyond {T} mm.",
        "NICHT KONFORM: E - U = {E} - {U} mm liegt über {T} mm.",
    ),
    "open": (
        "NEITHER conformity nor non-conformity with {T} mm is shown: E = {E} mm, U = {U} mm.",
        "WEDER Konformität noch Nichtkonformität mit {T} mm ist gezeigt: E = {E} mm, U = {U} mm.",
    ),
    "rule": (
        "Decision rule: guard band w = U = {U} mm (ISO 14253-1, ILAC-G8). Conformity is stated where E <= {T} mm - w; "
        "it is false in 2.5 % of cases at most.",
        "Entscheidungsregel: Schutzabstand w = U = {U} mm (ISO 14253-1, ILAC-G8). Konformität bei E <= {T} mm - w; "
        "sie ist in höchstens 2,5 % der Fälle falsch.",
    ),
    "no_traceability": (
        "Traceability of the instrument is not stated: these data show none.",
        "Die Rückführung des Messgeräts ist nicht angegeben: diese Daten weisen keine nach.",
    ),
    "no_calibrated": (
        "No calibration of the instrument is stated: its noise and scale are what the issuer says.",
        "Keine Kalibrierung des Messgeräts angegeben: Rauschen und Maßstab sind Aussagen des Ausstellers.",
    ),
    "no_temperature": (
        "No temperature is stated: its share in the uncertainty is missing.",
        "Keine Temperatur angegeben: ihr Anteil an der Unsicherheit fehlt.",
    ),
    "no_noise": (
        "Noise of the instrument is not stated, and no reading is repeated: it stays in E as an error.",
        "Das Rauschen des Messgeräts ist nicht angegeben und keine Messung wiederholt: es bleibt in E enthalten.",
    ),
    "no_repeatability": (
        "Repeatability is not stated, and no reading is repeated: it stays in E as an error.",
        "Die Wiederholbarkeit ist nicht angegeben und keine Messung wiederholt: sie bleibt in E enthalten.",
    ),
    "no_tolerance": ("No tolerance is stated.", "Keine Toleranz angegeben."),
    "source": ("source", "Quelle"),
    "type": ("type", "Typ"),
    "adds": ("in E² [mm²]", "in E² [mm²]"),
    "u_square": ("u(E²) [mm²]", "u(E²) [mm²]"),
    "freedom": ("deg. of freedom", "Freiheitsgrade"),
    "share": ("u(E) [mm]", "u(E) [mm]"),
    "of_instrument": ("instrument: noise, scale", "Messgerät: Rauschen, Maßstab"),
    "of_repeatability": ("repeatability", "Wiederholbarkeit"),
    "of_model": ("model between the poses", "Modell zwischen den Posen"),
    "of_frames": ("frames fitted", "Koordinatensysteme angepasst"),
    "of_temperature": ("temperature", "Temperatur"),
    "of_sampling": ("sampling of the space", "Stichprobe des Raums"),
    "mean_square": ("mean square of the held-out errors", "mittleres Quadrat der Abweichungen"),
    "formula": (
        "E² = (3n + t)/(3n - k) mean(e²) - 3 (s_n² + s_r²) + R² (u_s² + u_t²);  u(E) = u(E²) / (2 E);  u(E²) is the "
        "root of the sum of squares. e: held-out errors at n poses, k numbers fitted to them, t of them the tool's; "
        "s_n noise, s_r repeatability of a coordinate; R: rms distance of the poses from their centre; u_s scale, u_t "
        "growth.",
        "E² = (3n + t)/(3n - k) Mittel(e²) - 3 (s_n² + s_r²) + R² (u_s² + u_t²);  u(E) = u(E²) / (2 E);  u(E²): Wurzel "
        "der Quadratsumme. e: Abweichungen an n Posen, k Zahlen daran angepasst, t davon das Werkzeug; s_n Rauschen, "
        "s_r Wiederholbarkeit je Koordinate; R: mittlerer Abstand der Posen von ihrer Mitte; u_s Maßstab, u_t "
        "Ausdehnung.",
    ),
    "expanded": (
        "U = k u(E), k = {k}: Student's t for 95.45 % at {freedom} effective degrees of freedom (Welch-Satterthwaite).",
        "U = k u(E), k = {k}: Student-t für 95,45 % bei {freedom} effektiven Freiheitsgraden (Welch-Satterthwaite).",
    ),
    "distance": ("distance from the base's axis [mm]", "Abstand von der Basisachse [mm]"),
    "height": ("height [mm]", "Höhe [mm]"),
    "caption": (
        "Each point is a held-out pose: light blue up to the rms of its picture, blue up to twice, orange up to three "
        "times, red beyond.",
        "Jeder Punkt ist eine zurückgehaltene Pose: hellblau bis zum RMS des Bildes, blau bis zum Zwei-, orange bis "
        "zum Dreifachen, rot darüber.",
    ),
    "iso": (
        "AP, RP, vAP by the standard's definitions; the poses' own table holds every visit.",
        "AP, RP, vAP nach den Definitionen der Norm; jeder Anlauf steht in der Tabelle der Prüfung.",
    ),
    "iso_model": (
        "The calibrated model leaves {model} mm rms at the mean places. ",
        "Das kalibrierte Modell lässt an den mittleren Orten {model} mm RMS. ",
    ),
}


@cache
def words_of(language: str) -> Mapping[str, str]:
    """All sentences of a language, en or de."""
    k = LANGUAGES.index(language)
    return {key: pair[k] for key, pair in _WORDS.items()}
