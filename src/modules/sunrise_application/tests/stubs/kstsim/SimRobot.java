package kstsim;

import com.kuka.roboticsAPI.conditionModel.ICondition;
import com.kuka.roboticsAPI.executionModel.CommandInvalidException;
import com.kuka.roboticsAPI.executionModel.IFiredConditionInfo;
import com.kuka.roboticsAPI.motionModel.IMotionContainer;
import java.nio.file.Files;
import java.nio.file.Paths;
import java.util.List;
import java.util.Properties;
import java.util.function.BooleanSupplier;
import java.util.function.DoubleFunction;

/**
 * A robot that obeys at once within its joint speeds. Set by system properties:
 * sim.model (7 or 14), sim.flange (m), sim.q0 (seven rad, commas),
 * sim.tau_ext, sim.tau_msr (seven Nm), sim.force, sim.moment (three, N and Nm, in the tool frame),
 * sim.values (a properties file, read again at each query: those torques and forces less the prefix, and
 * speed, a factor on time, mode, enabling, stop, load (false: the load check fails)),
 * sim.snap (true: the servo jumps to its goal).
 */
public final class SimRobot {
    public static final boolean R820 = "14".equals(System.getProperty("sim.model", "7"));
    public static final Kin KIN = new Kin(R820, Double.parseDouble(System.getProperty("sim.flange", "0.035")));
    private static final double DEG = Math.PI / 180;
    public static final double[] QMAX = {170 * DEG, 120 * DEG, 170 * DEG, 120 * DEG, 170 * DEG, 120 * DEG, 175 * DEG};
    public static final double[] VMAX = R820
            ? new double[] {85 * DEG, 85 * DEG, 100 * DEG, 75 * DEG, 130 * DEG, 135 * DEG, 135 * DEG}
            : new double[] {98 * DEG, 98 * DEG, 100 * DEG, 130 * DEG, 140 * DEG, 180 * DEG, 180 * DEG};
    private static final boolean SNAP = Boolean.getBoolean("sim.snap");

    private static double[] q = list("sim.q0", 7);
    private static double[] goal;
    private static double servoRel = 1;
    private static long last = System.nanoTime();

    private SimRobot() { }

    private static double[] list(String key, int n) { return parse(System.getProperty(key), n); }

    private static double[] parse(String s, int n) {
        double[] v = new double[n];
        if (s != null) {
            String[] p = s.split(",");
            for (int i = 0; i < n && i < p.length; i++) v[i] = Double.parseDouble(p[i].trim());
        }
        return v;
    }

    private static double[] value(String key, int n) {
        String file = System.getProperty("sim.values");
        if (file != null) {
            try {
                String found = load(file).getProperty(key);
                if (found != null) return parse(found, n);
            } catch (java.io.IOException e) {
                // the file is optional
            }
        }
        return list("sim." + key, n);
    }

    private static Properties load(String file) throws java.io.IOException {
        Properties p = new Properties();
        try (java.io.Reader reader = Files.newBufferedReader(Paths.get(file))) {
            p.load(reader);
        }
        return p;
    }

    /** A word of the same file: mode (T1), enabling (NORMAL), stop (NOSTOP). */
    public static String word(String key, String standard) {
        String file = System.getProperty("sim.values");
        try {
            return file == null ? standard : load(file).getProperty(key, standard);
        } catch (java.io.IOException e) {
            return standard;
        }
    }

    private static double speed() { return Double.parseDouble(word("speed", "1")); }

    /** Prints what the application asked of the controller. */
    public static void note(String call) { System.out.println("CALL " + call); }

    public static double[] tauExternal() { return value("tau_ext", 7); }
    public static double[] tauMeasured() { return value("tau_msr", 7); }
    public static double[] force() { return value("force", 3); }
    public static double[] moment() { return value("moment", 3); }

    private static void advance() {
        long now = System.nanoTime();
        double dt = (now - last) * 1e-9 * speed();
        last = now;
        if (goal == null) return;
        for (int i = 0; i < 7; i++) {
            double step = VMAX[i] * servoRel * dt, e = goal[i] - q[i];
            q[i] += SNAP ? e : Math.max(-step, Math.min(step, e));
        }
    }

    public static synchronized double[] joints() {
        advance();
        return q.clone();
    }

    public static synchronized void servoGoal(double[] g) {
        for (int i = 0; i < 7; i++)
            if (!(Math.abs(g[i]) <= QMAX[i]))
                throw new IllegalStateException("destination of joint " + (i + 1) + " is out of range: " + g[i]);
        advance();
        goal = g.clone();
    }

    public static synchronized double[] currentGoal() { return goal == null ? q.clone() : goal.clone(); }

    public static synchronized void startServo(double rel) {
        last = System.nanoTime();
        goal = q.clone();
        servoRel = rel;
    }

    public static synchronized void stopServo() {
        advance();
        goal = null;
    }

    private static synchronized void place(double[] v) { q = v.clone(); }

    private static void checkJoints(double[] target) {
        for (int i = 0; i < 7; i++)
            if (!(Math.abs(target[i]) <= QMAX[i]))
                throw new CommandInvalidException("joint " + (i + 1) + " is out of range: " + target[i]);
    }

    public static IMotionContainer ptp(double[] target, double rel, List<ICondition> stop) {
        if (!(rel > 0 && rel <= 1)) throw new IllegalArgumentException("relative velocity " + rel + " is not in (0, 1]");
        checkJoints(target);
        double[] from = joints();
        double t = 0;
        for (int i = 0; i < 7; i++) t = Math.max(t, 1.5 * Math.abs(target[i] - from[i]) / (VMAX[i] * rel));
        return follow(t, stop, s -> {
            double[] v = new double[7];
            for (int i = 0; i < 7; i++) v[i] = from[i] + s * (target[i] - from[i]);
            return v;
        });
    }

    /** Moves the tool along a path of poses [x, y, z in mm, A, B, C in rad] at a speed in mm/s. */
    public static IMotionContainer path(DoubleFunction<double[]> poses, double lengthMm, double mmPerS,
            double[][] tool, List<ICondition> stop) {
        if (!(mmPerS > 0)) throw new IllegalArgumentException("Cartesian velocity " + mmPerS + " is not positive");
        double[][] end = Kin.fromXyzAbc(poses.apply(1));
        double[] trial = joints();
        for (int k = 1; k <= 50; k++) trial = KIN.ik(trial, Kin.fromXyzAbc(poses.apply(k / 50.0)), tool, 50);
        double[][] reached = KIN.fk(trial, tool);
        for (int i = 0; i < 3; i++)
            if (Math.abs(reached[i][3] - end[i][3]) > 1e-4) throw new CommandInvalidException("the pose cannot be reached");
        checkJoints(trial);
        double t = 1.5 * Math.max(lengthMm, 1e-3) / mmPerS;
        double[][] holder = {joints()};
        return follow(t, stop, s -> {
            holder[0] = KIN.ik(holder[0], Kin.fromXyzAbc(poses.apply(s)), tool, 30);
            return holder[0];
        });
    }

    /** A motion that ends when the enabling switch of the hand guiding is released, or is cancelled. */
    public static IMotionContainer guide() {
        note("move");
        boolean[] pressed = {false};
        return begin(new Run(1e9, java.util.Collections.<ICondition>emptyList(), s -> joints(), () -> {
            boolean now = "HANDGUIDING".equals(word("enabling", "NORMAL"));
            boolean released = pressed[0] && !now;
            pressed[0] |= now;
            return released;
        }));
    }

    /** What a servo motion gives back; its runtime ends it. */
    public static IMotionContainer servo() { return null; }

    private static IMotionContainer follow(double seconds, List<ICondition> stop, DoubleFunction<double[]> at) {
        note("move");
        return begin(new Run(seconds, stop, at, () -> false));
    }

    private static IMotionContainer begin(Run run) {
        Thread thread = new Thread(run, "motion");
        thread.setDaemon(true);
        thread.start();
        return run;
    }

    /** A motion under way. A cancel brings its rate to zero within 0.1 s. */
    private static final class Run implements Runnable, IMotionContainer {
        private static final double BRAKES_S = 0.1;
        private final double seconds;
        private final List<ICondition> stop;
        private final DoubleFunction<double[]> at;
        private final BooleanSupplier over;
        private volatile boolean cancelled;
        private volatile boolean finished;
        private volatile ICondition fired;

        Run(double seconds, List<ICondition> stop, DoubleFunction<double[]> at, BooleanSupplier over) {
            this.seconds = seconds;
            this.stop = stop;
            this.at = at;
            this.over = over;
        }

        @Override
        public void run() {
            long last = System.nanoTime();
            double done = 0;
            double rate = 1;
            while (true) {
                long now = System.nanoTime();
                double dt = (now - last) * 1e-9;
                last = now;
                if (cancelled || fired != null) rate = Math.max(0, rate - dt / BRAKES_S);
                done += rate * dt * speed();
                double u = seconds <= 0 ? 1 : Math.min(1, done / seconds);
                place(at.apply(u * u * (3 - 2 * u)));
                if (u >= 1 || rate == 0 || over.getAsBoolean()) break;
                for (ICondition each : stop) if (fired == null && each.fired()) fired = each;
                com.kuka.common.ThreadUtil.milliSleep(2);
            }
            finished = true;
        }

        @Override
        public boolean isFinished() { return finished; }

        @Override
        public void cancel() {
            if (!cancelled) note("cancel");
            cancelled = true;
        }

        @Override
        public boolean hasError() { return false; }

        @Override
        public String getErrorMessage() { return null; }

        @Override
        public IFiredConditionInfo getFiredBreakConditionInfo() {
            ICondition first = fired;
            return first == null ? null : () -> first;
        }
    }
}
