package leaprig;

/** The servo modes: what is sent to the arm in each cycle. One thread steps it; goals come from another. */
final class Servo {
    enum Kind { JOINTS, POSE, SPEED }

    /** In velocity mode the joints brake when no new velocity has come for so long [s]. */
    static final double SPEED_HOLDS = 0.5;
    private static final double REACH = 0.07;
    private static final double WIDTH = 0.0525;
    private final Arm arm;
    private final Brake brake = new Brake();
    private final double[] joints = new double[7];
    private final double[] goal = new double[7];
    private final double[] pose = new double[6];
    private final double[] destination = new double[7];
    private final double[] speed = new double[7];
    private final double[] wanted = new double[7];
    private double last;
    private boolean braking;
    Kind kind = Kind.JOINTS;
    Soft soft = Soft.STIFF;

    Servo(Arm arm) { this.arm = arm; }

    /** Starts the mode where the arm is; earlier goals are lost. */
    void start(Kind newKind, Soft newSoft, Goals goals, double now) {
        kind = newKind;
        soft = newSoft;
        arm.startServo(soft);
        begin(goals, now);
    }

    private void begin(Goals goals, double now) {
        arm.joints(joints);
        System.arraycopy(joints, 0, destination, 0, 7);
        java.util.Arrays.fill(speed, 0);
        goals.reset(joints, arm.pose(), now);
        brake.reset();
        braking = false;
        last = now;
    }

    /** Whether the mode can brake and go on; else it is ended. */
    boolean holds() { return kind != Kind.POSE && soft.kind != Soft.Kind.FLOAT; }

    void brake() {
        brake.begin();
        braking = true;
    }

    boolean braking() { return braking; }

    /** Goes on after it braked; false: the arm is not at rest yet. */
    boolean resume(Goals goals, double now) {
        if (!brake.resting()) return false;
        begin(goals, now);
        return true;
    }

    /** One cycle. Returns why the goal cannot be followed, or null. */
    String step(Goals goals, double now) {
        double seconds = now - last;
        last = now;
        arm.joints(joints);
        if (braking) {
            brake.advance(seconds, destination);
            arm.servo(destination);
            return null;
        }
        brake.note(joints, now);
        if (kind == Kind.POSE) {
            goals.pose(pose);
            for (int i = 0; i < 6; i++)
                if (Double.isNaN(pose[i]) || Double.isInfinite(pose[i])) return "the pose is not finite";
            arm.servoPose(pose);
            return null;
        }
        if (soft.kind == Soft.Kind.FLOAT) {
            System.arraycopy(joints, 0, destination, 0, 7);
        } else if (kind == Kind.SPEED) {
            goals.speed(wanted, now - SPEED_HOLDS);
            for (int i = 0; i < 7; i++) {
                destination[i] += 0.5 * (speed[i] + wanted[i]) * seconds;
                speed[i] = wanted[i];
            }
        } else {
            goals.joints(goal);
            for (int i = 0; i < 7; i++)
                destination[i] = soft.kind == Soft.Kind.STIFF ? joints[i] + law(goal[i] - joints[i]) : goal[i];
            int joint = Limits.outside(goal);
            if (joint >= 0) return "joint " + (joint + 1) + " is to go to " + goal[joint] + " rad, beyond its range";
        }
        int joint = Limits.outside(destination);
        if (joint >= 0) return "joint " + (joint + 1) + " is at the end of its range";
        arm.servo(destination);
        return null;
    }

    void stop() { arm.stopServo(); }

    /** f(e) = sign(e) a (1 - exp(-(e/b)^2)), the law of the published server's universal builds. */
    static double law(double error) {
        double scaled = error / WIDTH;
        return -Math.signum(error) * REACH * Math.expm1(-scaled * scaled);
    }
}
