package leaprig;

import static com.kuka.roboticsAPI.motionModel.BasicMotions.circ;
import static com.kuka.roboticsAPI.motionModel.BasicMotions.lin;
import static com.kuka.roboticsAPI.motionModel.BasicMotions.ptp;

import com.kuka.connectivity.motionModel.directServo.DirectServo;
import com.kuka.connectivity.motionModel.directServo.IDirectServoRuntime;
import com.kuka.connectivity.motionModel.smartServo.ISmartServoRuntime;
import com.kuka.connectivity.motionModel.smartServo.ServoMotion;
import com.kuka.connectivity.motionModel.smartServo.SmartServo;
import com.kuka.roboticsAPI.conditionModel.ForceCondition;
import com.kuka.roboticsAPI.conditionModel.ICondition;
import com.kuka.roboticsAPI.conditionModel.JointTorqueCondition;
import com.kuka.roboticsAPI.deviceModel.JointEnum;
import com.kuka.roboticsAPI.deviceModel.JointPosition;
import com.kuka.roboticsAPI.deviceModel.LBR;
import com.kuka.roboticsAPI.executionModel.IFiredConditionInfo;
import com.kuka.roboticsAPI.geometricModel.CartDOF;
import com.kuka.roboticsAPI.geometricModel.Frame;
import com.kuka.roboticsAPI.geometricModel.LoadData;
import com.kuka.roboticsAPI.geometricModel.ObjectFrame;
import com.kuka.roboticsAPI.geometricModel.Tool;
import com.kuka.roboticsAPI.geometricModel.math.Vector;
import com.kuka.roboticsAPI.geometricModel.math.XyzAbcTransformation;
import com.kuka.roboticsAPI.motionModel.CIRC;
import com.kuka.roboticsAPI.motionModel.HRCMotions;
import com.kuka.roboticsAPI.motionModel.IMotionContainer;
import com.kuka.roboticsAPI.motionModel.LIN;
import com.kuka.roboticsAPI.motionModel.PTP;
import com.kuka.roboticsAPI.motionModel.controlModeModel.CartesianImpedanceControlMode;
import com.kuka.roboticsAPI.motionModel.controlModeModel.IMotionControlMode;
import com.kuka.roboticsAPI.motionModel.controlModeModel.JointImpedanceControlMode;
import java.util.LinkedHashMap;
import java.util.Map;

/** The arm by KUKA's interface; the only class but the application itself that touches it. */
final class SunriseArm implements Arm {
    private static final double TRAJECTORY_TIME = 0.04;
    private static final double SOFT_TRAJECTORY_TIME = 0.02;
    private static final double SOFT_SPEED = 0.25;
    private static final double TOOLBOX_SOFT_SPEED = 0.1;
    private final LBR lbr;
    private final JointPosition destination = new JointPosition(7);
    private volatile Tool tool;
    private volatile ObjectFrame point;
    private int tools;
    private IMotionContainer running;
    private Map<ICondition, String> conditions;
    private IDirectServoRuntime direct;
    private ISmartServoRuntime smart;

    SunriseArm(LBR lbr) {
        this.lbr = lbr;
        attach(new ToolData());
    }

    @Override
    public void joints(double[] into) {
        JointPosition q = lbr.getCurrentJointPosition();
        for (int i = 0; i < 7; i++) into[i] = q.get(i);
    }

    @Override
    public double[] measuredTorques() { return lbr.getMeasuredTorque().getTorqueValues(); }

    @Override
    public double[] externalTorques() { return lbr.getExternalTorque().getTorqueValues(); }

    @Override
    public double[] pose() {
        Frame f = lbr.getCurrentCartesianPosition(point);
        return new double[] {f.getX(), f.getY(), f.getZ(), f.getAlphaRad(), f.getBetaRad(), f.getGammaRad()};
    }

    @Override
    public double[] force() { return numbers(lbr.getExternalForceTorque(point).getForce()); }

    @Override
    public double[] moment() { return numbers(lbr.getExternalForceTorque(point).getTorque()); }

    private static double[] numbers(Vector v) { return new double[] {v.getX(), v.getY(), v.getZ()}; }

    @Override
    public double[] attach(ToolData data) {
        double[] c = data.centre();
        double[] f = data.frame;
        LoadData load = new LoadData();
        load.setMass(data.mass());
        load.setCenterOfMass(c[0], c[1], c[2]);
        tools++;
        Tool made = new Tool("LeapRigTool" + tools, load);
        ObjectFrame tcp = made.addChildFrame("TCP" + tools, XyzAbcTransformation.ofRad(f[0], f[1], f[2], f[3], f[4], f[5]));
        made.setDefaultMotionFrame(tcp);
        if (tool != null) tool.detach();
        made.attachTo(lbr.getFlange());
        tool = made;
        point = tcp;
        return new double[] {made.getLoadData().getMass(), c[0], c[1], c[2]};
    }

    @Override
    public boolean mayBeSoft() { return ServoMotion.validateForImpedanceMode(tool); }

    @Override
    public void start(Motion motion) {
        running = null;
        conditions = conditions(motion);
        if (motion.kind == Motion.Kind.JOINTS) {
            PTP way = ptp(motion.target).setJointVelocityRel(motion.speed);
            for (ICondition each : conditions.keySet()) way = way.breakWhen(each);
            running = point.moveAsync(way);
        } else if (motion.kind == Motion.Kind.LINE) {
            LIN way = lin(frame(motion.target)).setCartVelocity(motion.speed);
            for (ICondition each : conditions.keySet()) way = way.breakWhen(each);
            running = point.moveAsync(way);
        } else if (motion.kind == Motion.Kind.CIRCLE) {
            CIRC way = circ(frame(motion.via), frame(motion.target)).setCartVelocity(motion.speed);
            for (ICondition each : conditions.keySet()) way = way.breakWhen(each);
            running = point.moveAsync(way);
        } else {
            running = lbr.moveAsync(HRCMotions.handGuiding());
        }
    }

    private Map<ICondition, String> conditions(Motion motion) {
        Map<ICondition, String> made = new LinkedHashMap<ICondition, String>();
        double[] guard = motion.guard;
        for (int i = 0; guard != null && i < guard.length; i += 3)
            made.put(new JointTorqueCondition(JointEnum.values()[(int) guard[i]], guard[i + 1], guard[i + 2]),
                    "joint " + ((int) guard[i] + 1));
        double[] limits = motion.contact;
        for (int i = 0; limits != null && i < 7; i++)
            if (limits[i] > 0)
                made.put(new JointTorqueCondition(JointEnum.values()[i], -limits[i], limits[i]), "joint " + (i + 1));
        if (limits != null && limits[7] > 0)
            made.put(ForceCondition.createSpatialForceCondition(point, limits[7]), "force");
        return made;
    }

    private Frame frame(double[] pose) {
        Frame f = lbr.getCurrentCartesianPosition(point);
        f.setX(pose[0]);
        f.setY(pose[1]);
        f.setZ(pose[2]);
        f.setAlphaRad(pose[3]);
        f.setBetaRad(pose[4]);
        f.setGammaRad(pose[5]);
        return f;
    }

    @Override
    public boolean finished() { return running == null || running.isFinished(); }

    @Override
    public void cancel() {
        if (running != null) running.cancel();
    }

    @Override
    public String broken() {
        IFiredConditionInfo fired = running == null ? null : running.getFiredBreakConditionInfo();
        if (fired == null) return null;
        for (Map.Entry<ICondition, String> each : conditions.entrySet())
            if (each.getKey().equals(fired.getFiredCondition())) return each.getValue();
        return "a condition";
    }

    @Override
    public String error() { return running != null && running.hasError() ? String.valueOf(running.getErrorMessage()) : null; }

    @Override
    public void startServo(Soft soft) {
        direct = null;
        smart = null;
        if (soft.kind == Soft.Kind.STIFF) {
            DirectServo motion = new DirectServo(lbr.getCurrentJointPosition());
            motion.setMinimumTrajectoryExecutionTime(TRAJECTORY_TIME);
            point.moveAsync(motion);
            direct = motion.getRuntime();
        } else {
            double speed = soft.kind == Soft.Kind.TOOLBOX ? TOOLBOX_SOFT_SPEED : SOFT_SPEED;
            SmartServo motion = new SmartServo(lbr.getCurrentJointPosition());
            motion.setJointVelocityRel(speed);
            motion.setJointAccelerationRel(speed);
            motion.setMinimumTrajectoryExecutionTime(SOFT_TRAJECTORY_TIME);
            motion.setMode(mode(soft));
            point.moveAsync(motion);
            smart = motion.getRuntime();
        }
    }

    private static IMotionControlMode mode(Soft soft) {
        double[] n = soft.numbers;
        if (soft.kind == Soft.Kind.FLOAT) {
            JointImpedanceControlMode free = new JointImpedanceControlMode(0, 0, 0, 0, 0, 0, 0);
            free.setDampingForAllJoints(0.7);
            return free;
        }
        if (soft.kind == Soft.Kind.JOINTS) {
            JointImpedanceControlMode springs = new JointImpedanceControlMode(n[0], n[1], n[2], n[3], n[4], n[5], n[6]);
            springs.setDampingForAllJoints(n[7]);
            return springs;
        }
        CartesianImpedanceControlMode springs = new CartesianImpedanceControlMode();
        if (soft.kind == Soft.Kind.TOOLBOX) {
            springs.parametrize(CartDOF.TRANSL).setStiffness(n[4]);
            springs.parametrize(CartDOF.ROT).setStiffness(n[5]);
            springs.setNullSpaceStiffness(n[6]);
            springs.setMaxPathDeviation(50, 50, 50, 50, 50, 50);
            return springs;
        }
        CartDOF[] axes = {CartDOF.X, CartDOF.Y, CartDOF.Z, CartDOF.A, CartDOF.B, CartDOF.C};
        for (int i = 0; i < 6; i++) springs.parametrize(axes[i]).setStiffness(n[i]);
        springs.parametrize(CartDOF.ALL).setDamping(n[6]);
        springs.setNullSpaceStiffness(n[7]);
        springs.setMaxControlForce(n[8], n[8], n[8], n[9], n[9], n[9], true);
        springs.setMaxPathDeviation(n[10], n[10], n[10], n[11], n[11], n[11]);
        return springs;
    }

    @Override
    public void servo(double[] joints) {
        for (int i = 0; i < 7; i++) destination.set(i, joints[i]);
        if (direct != null) {
            direct.updateWithRealtimeSystem();
            direct.setDestination(destination);
        } else {
            smart.updateWithRealtimeSystem();
            smart.setDestination(destination);
        }
    }

    @Override
    public void servoPose(double[] pose) {
        direct.updateWithRealtimeSystem();
        direct.setDestination(frame(pose));
    }

    @Override
    public void stopServo() {
        if (direct != null) direct.stopMotion();
        if (smart != null) smart.stopMotion();
    }

    @Override
    public String operationMode() { return String.valueOf(lbr.getOperationMode()); }

    @Override
    public String enabling() { return String.valueOf(lbr.getSafetyState().getEnablingDeviceState()); }

    @Override
    public String safetyStop() { return String.valueOf(lbr.getSafetyState().getSafetyStopSignal()); }
}
