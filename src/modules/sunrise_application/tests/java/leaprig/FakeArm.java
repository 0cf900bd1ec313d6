package leaprig;

import java.util.ArrayList;
import java.util.List;

/** An arm whose time is handed in, that obeys at once, takes down what it is asked, and refuses what is no number. */
final class FakeArm implements Arm {
    static final double BRAKES = 0.1;
    final List<String> calls = new ArrayList<String>();
    final double[] joints = new double[7];
    final double[] torques = new double[7];
    double force;
    double now;
    double lasts = 1;
    boolean servoing;
    boolean soft = true;
    boolean throwsAtStart;
    boolean throwsAtStop;
    boolean throwsInServo;
    boolean throwsWhenAsked;
    String stop = "NOSTOP";
    Motion motion;
    private double began;
    private double cancelledAt = Double.NaN;
    private String broke;
    String failed;

    @Override
    public void joints(double[] into) { System.arraycopy(joints, 0, into, 0, 7); }

    @Override
    public double[] measuredTorques() { return new double[7]; }

    @Override
    public double[] externalTorques() { return torques.clone(); }

    @Override
    public double[] pose() { return new double[] {500, 0, 500, 0, 0, 0}; }

    @Override
    public double[] force() { return new double[] {force, 0, 0}; }

    @Override
    public double[] moment() { return new double[3]; }

    @Override
    public double[] attach(ToolData tool) {
        double[] c = tool.centre();
        calls.add("attach " + tool.mass());
        return new double[] {tool.mass(), c[0], c[1], c[2]};
    }

    @Override
    public boolean mayBeSoft() { return soft; }

    @Override
    public void start(Motion started) {
        if (throwsAtStart) throw new IllegalStateException("cannot be reached");
        if (started.refusal() != null) throw new AssertionError("the arm is asked for " + started.refusal());
        calls.add("start " + started.kind);
        motion = started;
        began = now;
        cancelledAt = Double.NaN;
        broke = null;
    }

    @Override
    public boolean finished() {
        if (throwsWhenAsked) throw new IllegalStateException("nobody knows");
        if (motion == null) return true;
        if (motion.contact != null && Double.isNaN(cancelledAt))
            for (int i = 0; i < 7; i++)
                if (motion.contact[i] > 0 && Math.abs(torques[i]) > motion.contact[i]) broke = "joint " + (i + 1);
        if (motion.contact != null && motion.contact[7] > 0 && force > motion.contact[7]) broke = "force";
        if (motion.guard != null)
            for (int i = 0; i < motion.guard.length; i += 3) {
                double t = torques[(int) motion.guard[i]];
                if (t < motion.guard[i + 1] || t > motion.guard[i + 2]) broke = "joint " + ((int) motion.guard[i] + 1);
            }
        if (broke != null || failed != null) return true;
        if (!Double.isNaN(cancelledAt)) return now >= cancelledAt + BRAKES;
        if (now < began + lasts) return false;
        if (motion.kind == Motion.Kind.JOINTS) System.arraycopy(motion.target, 0, joints, 0, 7);
        return true;
    }

    @Override
    public void cancel() {
        if (throwsAtStop) throw new IllegalStateException("no cancel");
        calls.add("cancel");
        if (Double.isNaN(cancelledAt)) cancelledAt = now;
    }

    @Override
    public String broken() { return broke; }

    @Override
    public String error() { return failed; }

    @Override
    public void startServo(Soft how) {
        calls.add("servo " + how.kind);
        servoing = true;
    }

    @Override
    public void servo(double[] destination) {
        if (!servoing) throw new AssertionError("a destination without servo mode");
        if (throwsInServo) throw new IllegalStateException("the drives are off");
        if (Limits.outside(destination) >= 0) throw new AssertionError("a destination outside the ranges");
        System.arraycopy(destination, 0, joints, 0, 7);
    }

    @Override
    public void servoPose(double[] pose) {
        for (double each : pose) if (Double.isNaN(each) || Double.isInfinite(each)) throw new AssertionError("a pose");
    }

    @Override
    public void stopServo() {
        calls.add("stopServo");
        servoing = false;
        if (throwsAtStop) throw new IllegalStateException("no stop");
    }

    @Override
    public String operationMode() { return "T1"; }

    @Override
    public String enabling() { return "NORMAL"; }

    @Override
    public String safetyStop() { return stop; }
}
